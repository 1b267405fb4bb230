/* Between communication points: what a solver's step that ends there means to others. */
#ifndef MIDWAY_H
#define MIDWAY_H

#include "integration.h"
#include "state.h"

static bool pass_midway(Instance *self, double *end);

#if N_LIMITS > 0
/* When a motion first leaves each limit in a span; DBL_MAX: never, or it was outside before. */
static void find_leaving(Instance *self, const Motion *motion, double begin, double end,
                         double leaving[]);

/* Warn of those that have been left up to a time. */
static void note_leaving(Instance *self, double time, double leaving[]);
#else
static inline void find_leaving(Instance *self, const Motion *motion, double begin, double end,
                                double leaving[]) {
    (void)self, (void)motion, (void)begin, (void)end, (void)leaving;
}
static inline void note_leaving(Instance *self, double time, double leaving[]) {
    (void)self, (void)time, (void)leaving;
}
#endif

#endif
