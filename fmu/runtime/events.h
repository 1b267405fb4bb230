/* Events: relations that leave their modes, assignments, ends of runs. Without HAS_EVENTS there are
   none. */
#ifndef EVENTS_H
#define EVENTS_H

#include "modes.h"

/* What has happened at an instant. */
typedef struct {
    bool states_changed, ends;
} Outcome;

#if HAS_EVENTS
INSIDE_BEGIN

/* Where events go on from at the end of initialization. */
Status begin_events(Instance *self);

/* All that happens at the present time; `crossing` is the relation whose argument is 0, or -1. */
Status happen(Instance *self, int crossing, Outcome *outcome);

/* The next time event; `NO_EVENT` where there is none. */
double next_event(const Instance *self);

/* The end of a step of co-simulation, or the time event that only rounding is beyond it. */
double end_with_event(const Instance *self, double end);

bool run_stopped(const Instance *self);

/* What inputs and parameters that have just been set make happen before a step of co-simulation, or
   an event that the importer has not handled; false where it fails or ends the run. */
bool start_over(Instance *self);

/* Whether a step of co-simulation ends at an event, which the importer handles in event mode; then
   it waits. `crossing` is the relation whose argument is 0, or -1. */
bool leave_to_importer(Instance *self, int crossing);

/* The event that waits, as for `happen`; it waits no longer. */
int take_waiting(Instance *self);
bool event_waits(const Instance *self);

INSIDE_END
#else
static inline Status begin_events(Instance *self) {
    (void)self;
    return OK;
}
static inline Status happen(Instance *self, int crossing, Outcome *outcome) {
    (void)self, (void)crossing;
    *outcome = (Outcome){false, false};
    return OK;
}
static inline bool run_stopped(const Instance *self) {
    (void)self;
    return false;
}
static inline int take_waiting(Instance *self) {
    (void)self;
    return -1;
}
static inline bool event_waits(const Instance *self) {
    (void)self;
    return false;
}
#endif

#endif
