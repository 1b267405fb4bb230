/* Co-simulation: communication steps with inputs that move within them. A step that is
   fine may have been ended early by `Host.step_finished`; time tells. */
#ifndef STEPPING_H
#define STEPPING_H

#include "state.h"

static Status do_step(Instance *self, double from, double length);
static void forget_motion(Instance *self);
static Status set_motion(Instance *self, const uint32_t references[], size_t count,
                         const int32_t orders[], const double values[]);

#endif
