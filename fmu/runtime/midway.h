/* Between communication points: what a solver's step that ends there means to others. */
#ifndef MIDWAY_H
#define MIDWAY_H

#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

bool pass_midway(Instance *self, double *end);

INSIDE_END

#endif
