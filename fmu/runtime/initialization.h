/* From start values to a run. */
#ifndef INITIALIZATION_H
#define INITIALIZATION_H

#include <math.h>

#include "evaluation.h"
#include "events.h"
#include "logging.h"

static const double TIGHTEST_TOLERANCE = 1e-13; /* about 500 rounding errors */
static const double LOOSEST_TOLERANCE = 0.1;

/* Settle start time, stop time and tolerance; a null pointer leaves one undefined. */
static Status set_up(Instance *self, const double *tolerance, double start, const double *stop) {
    if (!isfinite(start)) return refuse(self, ERROR, "start time %g is not finite", start);
    if (stop && !(*stop >= start))
        return refuse(self, ERROR, "stop time %g is not after start time %g", *stop, start);
    if (tolerance && !(*tolerance > 0 && isfinite(*tolerance)))
        return refuse(self, ERROR, "relative tolerance %g is not positive and finite", *tolerance);

    State *state = &self->state;
    state->values[TIME] = start;
    state->stop_time = stop ? *stop : INFINITY;
    state->tolerance = DEFAULT_TOLERANCE;
    state->experiment_set = true;
    if (!tolerance) return OK;
    state->tolerance = fmin(fmax(*tolerance, TIGHTEST_TOLERANCE), LOOSEST_TOLERANCE);
    if (state->tolerance == *tolerance) return OK;
    return refuse(self, WARNING, "relative tolerance %g is out of reach; %g is used", *tolerance,
                  state->tolerance);
}

/* Leave initialization mode; an error when the start values have no solution. */
static Status finish_initialization(Instance *self) {
    if (refresh(self, START_VALUES | ALGEBRAICS) != OK)
        return refuse(self, ERROR, "initialization failed; change start values or parameters");
    if (start_events(self) != OK) return ERROR;
    warn_of_parameters(self);
    const bool events = self->state.interface == INTERFACE_ME || self->host.event_mode;
    self->state.mode = events ? EVENT_MODE : STEP_MODE;
    if (self->state.interface == INTERFACE_ME) return OK;
    Outcome outcome; /* what happens at the start */
    const Status status = handle_instant(self, -1, &outcome);
    keep_algebraics(self);
    return status;
}

#endif
