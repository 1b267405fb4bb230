/* From start values to a run. */
#ifndef INITIALIZATION_H
#define INITIALIZATION_H

#include "state.h"

static Status set_up(Instance *self, const double *tolerance, double start, const double *stop);
static Status finish_initialization(Instance *self);

#endif
