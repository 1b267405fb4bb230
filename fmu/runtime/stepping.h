/* Co-simulation: communication steps with inputs that move within them. A step that is
   fine may have been ended early by `Host.step_finished`; time tells. */
#ifndef STEPPING_H
#define STEPPING_H

#include <math.h>
#include <string.h>

#include "access.h"
#include "evaluation.h"
#include "events.h"
#include "input_motion.h"
#include "integration.h"
#include "logging.h"

static const double CLOCK_TOLERANCE = 1e-9; /* relative difference of clocks that agree */

/* The derivatives of the inputs are unknown until the importer sets them again. */
static void forget_motion(Instance *self) {
    memset(self->state.motion, 0, sizeof self->state.motion);
    memset(self->state.departure, 0, sizeof self->state.departure);
}

static void drop_spent_motion(Instance *self) {
    if (self->state.motion_spent) forget_motion(self);
    self->state.motion_spent = false;
}

/* One communication step. FMI 2 keeps what was reached when a step fails, and discards; FMI 3
   wants the instance as it was before. */
static Status do_step(Instance *self, double from, double length) {
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

    drop_spent_motion(self);
    leave_sides(self);
    reset_algebraics(self);
    const State before = self->state;
    self->state.stale &= ~(uint32_t)SIDES;
    self->state.steps++;
    const bool asks = self->host.ask_inputs != NULL;
    note_inputs(self, true);
    self->stepping = true;
    const bool done = (!asks || ask_for_motion(self, end)) && integrate_to(self, end);
    /* modes that slide follow from it, also at the end */
    if (asks && !event_waits(self) && !is_sliding_now(self)) forget_motion(self);
    self->stepping = self->state.mode == STEP_MODE;
    if (!self->stepping) return ERROR; /* by the importer's callback, or an event */
    self->state.motion_spent = true;
    self->state.step_status = done ? OK : DISCARD;
    keep_algebraics(self);
    note_inputs(self, false);
    if (done) note_limits(self);
    self->stepping = false;
    if (done) return OK;
    const bool stopped = run_stopped(self);
    if (stopped && self->host.fmi_version == 3) return OK;
    if (stopped) {
        self->state.mode = STEP_FAILED;
        return DISCARD;
    }
    const double reached = self->state.values[TIME];
    const Hint hint = limit_hint(self);
    if (self->host.fmi_version == 3) {
        self->state = before;
        self->state.stale |= JACOBIAN; /* it is not part of the state */
    } else {
        self->state.mode = STEP_FAILED;
    }
    return refuse(self, DISCARD, "the step from %.17g to %.17g came no further than %.17g%s%s", now,
                  end, reached, hint.joint, hint.limit);
}

/* Time derivatives of inputs for the next communication step; those of higher orders are dropped,
   as an importer may offer whatever its own side knows. */
static Status set_motion(Instance *self, const Reference references[], size_t count,
                         const Order orders[], const double values[]) {
    if (count == 0) return OK;
    if (!all_known(self, references, count)) return ERROR;
    if (!orders) return refuse(self, ERROR, "the orders are missing");
    if (!values) return refuse(self, ERROR, "there are no values");
    for (size_t i = 0; i < count; i++) {
        const VariableInfo *variable = &variables[references[i]];
        if (variable->role != INPUT)
            return refuse(self, ERROR, "%s is not an input", variable->name);
        if (!isfinite(values[i]))
            return refuse(self, DISCARD, "derivative %g of %s is not finite", values[i],
                          variable->name);
    }
    drop_spent_motion(self);
    leave_sides(self);
    Status status = OK;
    for (size_t i = 0; i < count; i++)
        if (orders[i] >= 1 && orders[i] <= MOST_INPUT_ORDER)
            self->state.motion[orders[i] - 1][references[i] - FIRST_INPUT] = values[i];
        else
            status = refuse(self, WARNING,
                            "inputs are polynomials of order %d; the derivative of order %d of %s "
                            "is dropped",
                            MOST_INPUT_ORDER, (int)orders[i], variables[references[i]].name);
    return status;
}

#endif
