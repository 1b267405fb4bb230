/* Events of an instance: what happens at its instants. Without HAS_EVENTS there are none. */
#ifndef EVENTS_H
#define EVENTS_H

#include "modes.h"

/* What has happened at an instant. */
typedef struct {
    bool states_changed, ends;
} Outcome;

#if HAS_EVENTS
/* The conditions of rules at the end of initialization. */
static Status start_events(Instance *self);

/* All that happens at the present time; `crossing` is the relation whose argument is 0, or -1. */
static Status handle_instant(Instance *self, int crossing, Outcome *outcome);

/* The next time event; NEVER_AGAIN where there is none. */
static double next_event(const Instance *self);

/* The end of a step of co-simulation, or the time event that only the rounding of an importer that
   adds its steps is beyond it. */
static double end_with_event(const Instance *self, double end);

/* The next time event, or the end of a step of co-simulation if only rounding is between them:
   there it happens again with the inputs that the importer sets. */
static double event_before(const Instance *self, double end);

/* The time of a crossing, or the end of a step of co-simulation if only rounding is between them:
   there it happens again with the inputs that the importer sets. */
static double end_if_only_rounding(const Instance *self, double time, double end);

static bool run_stopped(const Instance *self);

/* In event mode, until its first update, relations of time have the values that they have at the
   time itself: samples of other FMUs see them. */
static void enter_instant(Instance *self);
static void leave_instant(Instance *self);

/* Keep what was before an event at a communication point, as other inputs may be set there. */
static void remember_instant(Instance *self);

/* That event happens again, with inputs that have been set since, as it will in the next step. */
static void redo_instant(Instance *self);

/* That event does not happen again: a state has been set after it. */
static void keep_instant(Instance *self);

/* What inputs and parameters that have just been set make happen before a step of co-simulation, or
   an event that the importer has not handled; it waits for an importer that handles events. False
   where it fails or ends the run. */
static bool start_over(Instance *self);

/* How many samples there have been, before a parameter is set; after it, those that have not
   happened yet still do, and time events are planned anew. */
static void note_samples(Instance *self, double counts[]);
static void rebase_samples(Instance *self, const double counts[]);

/* Whether a step of co-simulation ends at an event, which the importer handles in event mode; then
   it waits. `crossing` is the relation whose argument is 0, or -1. */
static bool leave_to_importer(Instance *self, int crossing);

/* The event that waits, as for `handle_instant`; it waits no longer. */
static int take_waiting(Instance *self);
static bool event_waits(const Instance *self);
#else
#define start_events(self) ((void)(self), OK)
#define handle_instant(self, crossing, outcome)                                                    \
    ((void)(self), (void)(crossing), *(outcome) = (Outcome){false, false}, OK)
#define run_stopped(self) ((void)(self), false)
#define enter_instant(self) ((void)(self))
#define leave_instant(self) ((void)(self))
#define keep_instant(self) ((void)(self))
#define note_samples(self, counts) ((void)(self), (void)(counts))
#define rebase_samples(self, counts) ((void)(self), (void)(counts))
#define take_waiting(self) ((void)(self), -1)
#define event_waits(self) ((void)(self), false)
#endif

#endif
