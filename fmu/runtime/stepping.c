/* Co-simulation: communication steps with inputs that move linearly within them. */
#include "stepping.h"

#include <math.h>
#include <string.h>

#include "equations.h"

/* Attempts in one communication step. A failed one is repeated at a quarter of its length, so
   that the step ends within about 4^-5 of its length before what stops it. Attempts times the
   integrator's own limit of steps bound the work of a call. */
enum { MOST_ATTEMPTS = 12 };

static const double CLOCK_TOLERANCE = 1e-9; /* relative difference of clocks that agree */

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

/* Integrate up to `end`, or as far as it goes; time tells how far. */
static bool advance_to(Instance *self, double end) {
    double *time = &self->state.values[TIME];
    double length = end - *time;
    for (int attempt = 0; attempt < MOST_ATTEMPTS && *time < end; attempt++) {
        if (refresh(self, ALGEBRAICS) != OK) return false; /* the guess must be a solution */
        const double rest = end - *time;
        const bool last = length >= rest;
        if (advance(self, last ? rest : length))
            *time = last ? end : *time + length;
        else
            length = (last ? rest : length) / 4;
    }
    return *time >= end;
}

static void drop_spent_slopes(Instance *self) {
    if (self->state.slopes_spent) memset(self->state.slopes, 0, sizeof self->state.slopes);
    self->state.slopes_spent = false;
}

/* One communication step. FMI 2 keeps what was reached when a step fails, and discards; FMI 3
   wants the instance as it was before. */
Status do_step(Instance *self, double from, double length) {
    const double now = self->state.values[TIME], end = from + length;
    const double slack = fmin(CLOCK_TOLERANCE * fmax(fabs(now), length), length / 2);
    if (!(length > 0) || !isfinite(end))
        return refuse(self, ERROR, "step size %g from time %g is not positive and finite", length,
                      from);
    if (!(fabs(from - now) <= slack))
        return refuse(self, ERROR, "the step begins at %.17g, the time here is %.17g", from, now);
    if (end > self->state.stop_time + slack)
        return refuse(self, ERROR, "the step ends at %.17g, beyond the stop time %.17g", end,
                      self->state.stop_time);

    drop_spent_slopes(self);
    const State before = self->state;
    const bool done = advance_to(self, end);
    self->state.slopes_spent = true;
    self->state.step_status = done ? OK : DISCARD;
    if (done) return OK;
    const double reached = self->state.values[TIME];
    if (self->host.fmi_version == 3)
        self->state = before;
    else
        self->state.mode = STEP_FAILED;
    return refuse(self, DISCARD, "the step from %.17g to %.17g came no further than %.17g", now,
                  end, reached);
}

static Status check_orders(Instance *self, size_t count, const int32_t orders[]) {
    if (!orders) return refuse(self, ERROR, "the orders are missing");
    for (size_t i = 0; i < count; i++)
        if (orders[i] < 1) return refuse(self, ERROR, "there is no derivative of order %d",
                                         (int)orders[i]);
    return OK;
}

/* First time derivatives of inputs for the next communication step. */
Status set_slopes(Instance *self, const uint32_t references[], size_t count, const int32_t orders[],
                  const double values[]) {
    if (count == 0) return OK;
    if (!known(self, references, count) || check_orders(self, count, orders) != OK) return ERROR;
    if (!values) return refuse(self, ERROR, "there are no values");
    for (size_t i = 0; i < count; i++) {
        const VariableInfo *variable = &variables[references[i]];
        if (variable->role != INPUT)
            return refuse(self, ERROR, "%s is not an input", variable->name);
        if (orders[i] > 1)
            return refuse(self, ERROR, "inputs are interpolated with order 1, not %d",
                          (int)orders[i]);
        if (!isfinite(values[i]))
            return refuse(self, DISCARD, "derivative %g of %s is not finite", values[i],
                          variable->name);
    }
    drop_spent_slopes(self);
    for (size_t i = 0; i < count; i++)
        self->state.slopes[references[i] - FIRST_INPUT] = values[i];
    return OK;
}

/* Time derivatives of outputs along the solution; those of higher order are given as 0. */
Status get_rates(Instance *self, const uint32_t references[], size_t count, const int32_t orders[],
                 double values[]) {
    if (count == 0) return OK;
    if (check_orders(self, count, orders) != OK) return ERROR;
    const Status status = time_derivatives(self, references, count, values);
    if (status != OK) return status;
    for (size_t i = 0; i < count; i++)
        if (orders[i] > 1) values[i] = 0.0;
    return OK;
}
