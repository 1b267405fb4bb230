/* Where a run leaves what its model is good for. */
#ifndef VALIDITY_H
#define VALIDITY_H

#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

void note_margins(Instance *self, const double margins[]);
const char *limit_left(const Instance *self);

INSIDE_END

#endif
