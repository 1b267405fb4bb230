/* When relations of time alone switch next. */
#ifndef TIME_EVENTS_H
#define TIME_EVENTS_H

#include "modes.h"

#if HAS_EVENTS
INSIDE_BEGIN

/* Set `due` and `next`, for times after `now`. */
void plan_time_events(Instance *self, double now);

/* Modes of relations of time alone, by value at a time. */
void modes_of_time(Instance *self, double t, double modes[]);

INSIDE_END
#endif

#endif
