/* Analytic derivatives of all results along a seed.

   Seeds and sensitivities are laid out like the values, by value reference. In
   initialization mode the calculated start values follow from the exact ones and the parameters;
   later all states are independent. */
#ifndef SENSITIVITY_H
#define SENSITIVITY_H

#include <math.h>
#include <string.h>

#include "access.h"
#include "equations.h"
#include "evaluation.h"
#include "logging.h"
#include "modes.h"

static bool is_starting(const Instance *self) {
    return self->state.mode == INITIALIZATION_MODE;
}

static bool is_known(const Instance *self, const VariableInfo *variable) {
    const Role role = variable->role;
    if (role == STATE) return variable->start_kind != CALCULATED || !is_starting(self);
    return role == TIME || role == INPUT || role == PARAMETER;
}

static bool is_unknown(const VariableInfo *variable) {
    const Role role = variable->role;
    return role == STATE || role == DERIVATIVE || role == ALGEBRAIC || role == OUTPUT;
}

static Status check_roles(Instance *self, const Reference unknowns[], size_t n_unknowns,
                          const Reference knowns[], size_t n_knowns) {
    if (!all_known(self, unknowns, n_unknowns) || !all_known(self, knowns, n_knowns)) return ERROR;
    for (size_t i = 0; i < n_unknowns; i++)
        if (!is_unknown(&variables[unknowns[i]]))
            return refuse(self, ERROR, "%s is not an unknown", variables[unknowns[i]].name);
    for (size_t i = 0; i < n_knowns; i++)
        if (!is_known(self, &variables[knowns[i]]))
            return refuse(self, ERROR, "%s is not a known", variables[knowns[i]].name);
    const Status status = refresh(self, ALGEBRAICS);
    if (status != OK || !is_sliding_now(self)) return status;
    return refuse(self, DISCARD, "there are no derivatives while an expression slides along 0");
}

static Status run(Instance *self, Equation *equation) {
    if (equation(self->arg, self->res, self->iw, self->w, 0))
        return refuse(self, DISCARD, "the derivative has no value");
    return OK;
}

static Status refuse_infinite(Instance *self, uint32_t reference, double value) {
    return refuse(self, DISCARD, "the derivative of %s is %g", variables[reference].name, value);
}

static Status gather(Instance *self, const Reference references[], size_t count,
                     const double results[], double values[]) {
    for (size_t i = 0; i < count; i++)
        if (!isfinite(results[references[i]]))
            return refuse_infinite(self, references[i], results[references[i]]);
    for (size_t i = 0; i < count; i++) values[i] = results[references[i]];
    return OK;
}

/* Spread a seed of what start values follow from to the calculated ones. */
static Status spread_to_starts(Instance *self, double seed[]) {
    double x[ROOM(NX)] = {0};
    const double *values = self->state.values;
    self->arg[0] = values + TIME;
    self->arg[1] = values + FIRST_STATE;
    self->arg[2] = values + FIRST_INPUT;
    self->arg[3] = self->constants;
    self->arg[4] = seed + FIRST_STATE;
    self->arg[5] = seed + FIRST_INPUT;
    self->arg[6] = seed + FIRST_PARAMETER;
    self->arg[7] = seed + TIME;
    self->res[0] = x;
    const Status status = run(self, model_start_directional);
    if (status == OK) memcpy(seed + FIRST_STATE, x, NX * sizeof(double));
    return status;
}

/* Derivatives of everything along a seed of what is independent; replaces the seed. */
static Status push_forward(Instance *self, double seed[]) {
    double result[N_VARIABLES];
    memcpy(result, seed, sizeof result);
    pass_values(self);
    self->arg[5] = seed + FIRST_STATE;
    self->arg[6] = seed + FIRST_INPUT;
    self->arg[7] = seed + FIRST_PARAMETER;
    self->arg[8] = seed + TIME;
    self->res[0] = result + FIRST_DERIVATIVE;
    self->res[1] = result + FIRST_ALGEBRAIC;
    self->res[2] = result + FIRST_OUTPUT;
    const Status status = run(self, model_directional);
    if (status == OK) memcpy(seed, result, sizeof result);
    return status;
}

/* Does the Jacobian of dx and z with respect to x and u answer? It costs as much as two or three
   columns on their own, is kept until a setter makes it stale, and serves importers that ask column
   by column. */
static bool in_jacobian(const Instance *self, const Reference unknowns[], size_t n_unknowns,
                        const Reference knowns[], size_t n_knowns) {
    if (is_starting(self) || n_knowns != 1) return false;
    const Role known_role = variables[knowns[0]].role;
    if (known_role != STATE && known_role != INPUT) return false;
    for (size_t i = 0; i < n_unknowns; i++) {
        const Role role = variables[unknowns[i]].role;
        if (role != DERIVATIVE && role != ALGEBRAIC) return false;
    }
    return true;
}

static Status column_of_jacobian(Instance *self, const Reference unknowns[], size_t n_unknowns,
                                 uint32_t known_reference, double seed, double sensitivity[]) {
    const Status status = refresh(self, JACOBIAN);
    if (status != OK) return status;
    const bool is_state = variables[known_reference].role == STATE;
    const size_t column =
        is_state ? known_reference - FIRST_STATE : known_reference - FIRST_INPUT + NX;
    const double *dx = self->jacobian + column * NX;
    const double *z = self->jacobian + NX * (NX + NU) + column * NZ;
    for (size_t i = 0; i < n_unknowns; i++) {
        const uint32_t k = unknowns[i];
        const bool is_rate = variables[k].role == DERIVATIVE;
        sensitivity[i] = seed * (is_rate ? dx[k - FIRST_DERIVATIVE] : z[k - FIRST_ALGEBRAIC]);
        if (!isfinite(sensitivity[i])) return refuse_infinite(self, k, sensitivity[i]);
    }
    return OK;
}

/* Jacobian of the unknowns with respect to the knowns, times the seed of the knowns. */
static Status directional(Instance *self, const Reference unknowns[], size_t n_unknowns,
                          const Reference knowns[], size_t n_knowns, const double seed[],
                          double sensitivity[]) {
    Status status = check_roles(self, unknowns, n_unknowns, knowns, n_knowns);
    if (status != OK) return status;
    if (n_knowns > 0 && !seed) return refuse(self, ERROR, "the seed is missing");
    if (n_unknowns > 0 && !sensitivity) return refuse(self, ERROR, "there is no room for results");

    if (in_jacobian(self, unknowns, n_unknowns, knowns, n_knowns))
        return column_of_jacobian(self, unknowns, n_unknowns, knowns[0], seed[0], sensitivity);
    double along[N_VARIABLES] = {0};
    for (size_t i = 0; i < n_knowns; i++) along[knowns[i]] += seed[i];
    if (is_starting(self)) status = spread_to_starts(self, along);
    if (status == OK) status = push_forward(self, along);
    return status == OK ? gather(self, unknowns, n_unknowns, along, sensitivity) : status;
}

/* Derivatives of everything with respect to time along the solution, inputs moving as declared. */
static Status all_rates(Instance *self, double rates[]) {
    const Status status = refresh(self, DERIVATIVES);
    if (status != OK) return status;
    memset(rates, 0, N_VARIABLES * sizeof *rates);
    rates[TIME] = 1;
    memcpy(rates + FIRST_STATE, self->state.values + FIRST_DERIVATIVE, NX * sizeof *rates);
    memcpy(rates + FIRST_INPUT, self->state.motion[0], NU * sizeof *rates);
    return push_forward(self, rates);
}

static Status time_derivatives(Instance *self, const Reference unknowns[], size_t count,
                               double rates[]) {
    double along[N_VARIABLES];
    Status status = check_roles(self, unknowns, count, NULL, 0);
    if (status == OK) status = all_rates(self, along);
    if (status != OK) return status;
    if (!rates) return refuse(self, ERROR, "there is no room for the values");
    return gather(self, unknowns, count, along, rates);
}

#endif
