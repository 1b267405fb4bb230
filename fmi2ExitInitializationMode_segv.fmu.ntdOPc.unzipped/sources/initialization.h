/* From start values to a run. */
#ifndef INITIALIZATION_H
#define INITIALIZATION_H

#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

Status set_up(Instance *self, const double *tolerance, double start, const double *stop);
Status finish_initialization(Instance *self);

INSIDE_END

#endif
