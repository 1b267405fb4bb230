/* Between communication points: what a solver's step that ends there means to others. */
#ifndef MIDWAY_H
#define MIDWAY_H

#include <float.h>
#include <math.h>

#include "evaluation.h"
#include "integration.h"
#if N_LIMITS > 0
#include "margins.h"
#endif

/* Warn of limits, and let the importer look and perhaps bring the end forward. False where it has
   called what it must not. */
static bool pass_midway(Instance *self, double *end) {
    note_limits(self);
    return !self->host.step_finished || self->host.step_finished(self, end);
}

#if N_LIMITS > 0
typedef struct {
    Instance *fmu;
    const Motion *motion;
    int limit;
} Margin;

static void all_margins(const Margin *self, double t, double margins[]) {
    if (!margins_on(self->fmu, self->motion, t, margins))
        for (int i = 0; i < N_LIMITS; i++) margins[i] = INFINITY; /* the equations failed */
}

static void measure_margin(void *margin, const double times[], double margins[]) {
    const Margin *self = margin;
    double every[N_LIMITS] = {0};
    for (int k = 0; k < LOOKS; k++) {
        all_margins(self, times[k], every);
        margins[k] = every[self->limit];
    }
}

/* When a motion first leaves each limit in a span; DBL_MAX: never, or it was outside before. */
static void find_leaving(Instance *self, const Motion *motion, double begin, double end,
                         double leaving[]) {
    Margin margin = {self, motion, 0};
    double times[LOOKS + 1] = {begin}, table[N_LIMITS][LOOKS + 1], every[N_LIMITS];
    places_within(begin, end, times + 1);
    for (int k = 0; k <= LOOKS; k++) {
        all_margins(&margin, times[k], every);
        for (int i = 0; i < N_LIMITS; i++) table[i][k] = every[i];
    }
    for (int i = 0; i < N_LIMITS; i++) {
        margin.limit = i;
        leaving[i] = !(table[i][0] > 0)
                         ? begin
                         : first_outside(measure_margin, &margin, begin, end, table[i]);
        if (self->state.outside >> i & 1 || leaving[i] == INFINITY) leaving[i] = DBL_MAX;
    }
}

/* Warn of those that have been left up to a time. */
static void note_leaving(Instance *self, double time, double leaving[]) {
    for (int i = 0; i < N_LIMITS; i++) {
        if (leaving[i] > time) continue;
        note_side(self, i, leaving[i], false);
        leaving[i] = DBL_MAX;
    }
}
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
