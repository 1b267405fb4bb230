/* Co-simulation: communication steps with inputs that move linearly within them. */
#ifndef STEPPING_H
#define STEPPING_H

#include "instance.h"

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility push(hidden)
#endif

Status do_step(Instance *self, double from, double length);
Status set_slopes(Instance *self, const uint32_t references[], size_t count, const int32_t orders[],
                  const double values[]);
Status get_rates(Instance *self, const uint32_t references[], size_t count, const int32_t orders[],
                 double values[]);

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility pop
#endif

#endif
