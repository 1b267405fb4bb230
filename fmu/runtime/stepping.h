/* Co-simulation: communication steps with inputs that move within them. A step that is
   fine may have been ended early by `Host.step_finished`; time tells. */
#ifndef STEPPING_H
#define STEPPING_H

#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

Status do_step(Instance *self, double from, double length);
void forget_motion(Instance *self);
Status set_motion(Instance *self, const uint32_t references[], size_t count, const int32_t orders[],
                  const double values[]);

INSIDE_END

#endif
