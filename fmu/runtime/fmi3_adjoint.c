/* FMI 3.0: adjoint derivatives, weights of results carried backwards. */
#include <string.h>

#include "derivatives.h"
#include "evaluation.h"
#include "fmi3.h"

#if NO_DERIVATIVES
static Status adjoint(Instance *self, const uint32_t unknowns[], size_t n_unknowns,
                      const uint32_t knowns[], size_t n_knowns, const double seed[],
                      double sensitivity[]) {
    return directional(self, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity);
}
#else
/* Collect a weight of the start values on what they follow from. The start rules are small: one run
   forward for each of these is enough. */
static Status collect_from_starts(Instance *self, double weight[]) {
    double collected[N_VARIABLES];
    memcpy(collected, weight, sizeof collected);
    for (int known = TIME; known < FIRST_OUTPUT; known++) {
        const Role role = variables[known].role;
        if (role == DERIVATIVE || role == ALGEBRAIC) continue;
        double along[N_VARIABLES] = {0};
        along[known] = 1;
        const Status status = spread_to_starts(self, along);
        if (status != OK) return status;
        if (role == STATE) collected[known] = 0;
        for (int i = FIRST_STATE; i < FIRST_DERIVATIVE; i++)
            collected[known] += weight[i] * along[i];
    }
    memcpy(weight, collected, sizeof collected);
    return OK;
}

/* The seed of the unknowns, as a row, times their Jacobian with respect to the knowns. */
static Status adjoint(Instance *self, const uint32_t unknowns[], size_t n_unknowns,
                      const uint32_t knowns[], size_t n_knowns, const double seed[],
                      double sensitivity[]) {
    Status status = check_roles(self, unknowns, n_unknowns, knowns, n_knowns);
    if (status != OK) return status;
    if (n_unknowns > 0 && !seed) return refuse(self, ERROR, "the seed is missing");
    if (n_knowns > 0 && !sensitivity) return refuse(self, ERROR, "there is no room for results");

    double weight[N_VARIABLES] = {0}, result[N_VARIABLES] = {0};
    for (size_t i = 0; i < n_unknowns; i++) weight[unknowns[i]] += seed[i];
    pass_values(self);
    self->arg[5] = weight + FIRST_DERIVATIVE;
    self->arg[6] = weight + FIRST_ALGEBRAIC;
    self->arg[7] = weight + FIRST_OUTPUT;
    self->res[0] = result + FIRST_STATE;
    self->res[1] = result + FIRST_INPUT;
    self->res[2] = result + FIRST_PARAMETER;
    self->res[3] = result + TIME;
    status = run(self, model_adjoint);
    for (int i = FIRST_STATE; i < FIRST_DERIVATIVE; i++) result[i] += weight[i];
    if (status == OK && is_starting(self)) status = collect_from_starts(self, result);
    return status == OK ? gather(self, knowns, n_knowns, result, sensitivity) : status;
}
#endif

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                    size_t nUnknowns, const fmi3ValueReference knowns[],
                                    size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                    fmi3Float64 sensitivity[], size_t nSensitivity) {
    Instance *self = instance;
    if (!allowed(self, IN_GET_DERIVATIVE, __func__)) return fmi3Error;
    if (!one_each(self, nSeed, nUnknowns) || !one_each(self, nSensitivity, nKnowns))
        return fmi3Error;
    return fmi3_status(adjoint(self, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity));
}
