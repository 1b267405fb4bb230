/* Analytic derivatives of all results along a seed, and what the adjoint ones share. */
#ifndef SENSITIVITY_H
#define SENSITIVITY_H

#include "equations.h"
#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

bool starting(const Instance *self);
Status check_roles(Instance *self, const uint32_t unknowns[], size_t n_unknowns,
                   const uint32_t knowns[], size_t n_knowns);
Status run(Instance *self, Equation *equation);
Status gather(Instance *self, const uint32_t references[], size_t count, const double results[],
              double values[]);
Status spread_to_starts(Instance *self, double seed[]);

Status directional(Instance *self, const uint32_t unknowns[], size_t n_unknowns,
                   const uint32_t knowns[], size_t n_knowns, const double seed[],
                   double sensitivity[]);
Status all_rates(Instance *self, double rates[]);
Status time_derivatives(Instance *self, const uint32_t unknowns[], size_t count, double rates[]);

INSIDE_END

#endif
