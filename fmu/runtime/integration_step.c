/* Co-simulation by a generated solver, which starts anew in every communication step. */
#include "integration.h"

#include <string.h>

#include "equations.h"
#include "evaluation.h"
#include "midway.h"

/* Attempts in one communication step. A failed one is repeated at a quarter of its length, so
   that the step ends within about 4^-5 of its length before what stops it. Failed attempts times
   the integrator's own limit of steps bound the work of a call. */
enum { MOST_ATTEMPTS = 12, MOST_FAILED = 6 };

/* Integrate over `length`; on failure nothing has changed. */
static bool advance(Instance *self, double length) {
    double *values = self->state.values, *u = values + FIRST_INPUT;
    double q[3 + 2 * NU + NP], x[ROOM(NX)] = {0}, z[ROOM(NZ)] = {0}, du[ROOM(NU)] = {0};
    for (int i = 0; i < NU; i++) du[i] = self->state.slopes[i] * length;
    q[0] = values[TIME];
    q[1] = length;
    q[2] = self->state.tolerance;
    memcpy(q + 3, u, NU * sizeof *u);
    memcpy(q + 3 + NU, du, NU * sizeof *du);
    memcpy(q + 3 + 2 * NU, values + FIRST_PARAMETER, NP * sizeof *values);
    self->arg[0] = values + FIRST_STATE;
    self->arg[1] = values + FIRST_ALGEBRAIC;
    self->arg[2] = q;
    self->res[0] = x;
    self->res[1] = z;
    if (model_step(self->arg, self->res, self->iw, self->w, 0)) return false;
    if (!all_finite(x, NX) || !all_finite(z, NZ)) return false;

    memcpy(values + FIRST_STATE, x, NX * sizeof *x);
    memcpy(values + FIRST_ALGEBRAIC, z, NZ * sizeof *z);
    for (int i = 0; i < NU; i++) u[i] += du[i];
    self->state.stale |= AFTER_START;
    return true;
}

bool integrate_to(Instance *self, double end) {
    double *time = &self->state.values[TIME];
    double length = end - *time;
    int failed = 0;
    for (int attempt = 0; attempt < MOST_ATTEMPTS && *time < end && failed < MOST_FAILED;
         attempt++) {
        if (refresh(self, ALGEBRAICS) != OK) return false; /* the guess must be a solution */
        const double rest = end - *time;
        const bool last = length >= rest;
#if HAS_RANK
        if (self->state.watch.looks == 0) begin_watching(self);
        const State before = self->state;
#endif
        if (advance(self, last ? rest : length)) {
            *time = last ? end : *time + length;
#if HAS_RANK
            if (look_back(self, DISCARD) != OK) {
                self->state = before;
                return false;
            }
#endif
            if (*time < end && !pass_midway(self, &end)) return false;
        } else {
            failed++;
            length = (last ? rest : length) / 4;
        }
    }
    return *time >= end;
}
