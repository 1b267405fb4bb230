/* Analytic derivatives of all results along a seed, and what the adjoint ones share. */
#ifndef SENSITIVITY_H
#define SENSITIVITY_H

#include "equations.h"
#include "state.h"

static bool starting(const Instance *self);
static Status check_roles(Instance *self, const uint32_t unknowns[], size_t n_unknowns,
                          const uint32_t knowns[], size_t n_knowns);
static Status run(Instance *self, Equation *equation);
static Status gather(Instance *self, const uint32_t references[], size_t count,
                     const double results[], double values[]);
static Status spread_to_starts(Instance *self, double seed[]);

static Status directional(Instance *self, const uint32_t unknowns[], size_t n_unknowns,
                          const uint32_t knowns[], size_t n_knowns, const double seed[],
                          double sensitivity[]);
static Status all_rates(Instance *self, double rates[]);
static Status time_derivatives(Instance *self, const uint32_t unknowns[], size_t count,
                               double rates[]);

#endif
