/* What the derivatives along a seed and the adjoint ones share. */
#ifndef SENSITIVITY_H
#define SENSITIVITY_H

#include "equations.h"
#include "instance.h"

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility push(hidden)
#endif

bool starting(const Instance *self);
Status check_roles(Instance *self, const uint32_t unknowns[], size_t n_unknowns,
                   const uint32_t knowns[], size_t n_knowns);
Status run(Instance *self, Equation *equation);
Status gather(Instance *self, const uint32_t references[], size_t count, const double results[],
              double values[]);
Status spread_to_starts(Instance *self, double seed[]);

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility pop
#endif

#endif
