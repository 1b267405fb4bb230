/* Between communication points: what a solver's step that ends there means to others. */
#ifndef MIDWAY_H
#define MIDWAY_H

#include <float.h>
#include <math.h>
#include <string.h>

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

#if BOUNDED_LIMITS > 0
enum { MOVING = NX + NU - MODES };

/* Between which values what moves margins, and its rates, stay on a part of a motion. */
typedef struct {
    double begin, length, low[MOVING + 1], high[MOVING + 1], slowest[MOVING + 1],
        fastest[MOVING + 1], u[ROOM(NU)];
} Part;

static void enclose_part(const Margin *self, double begin, double end, Part *found) {
    double x[ROOM(NX)] = {0}, z[ROOM(NZ)] = {0}, values[MOVING + 1][NODES];
    found->begin = begin;
    found->length = end - begin;
    for (int k = NODES - 1; k >= 0; k--) {
        self->motion->at(self->motion->solver, node_between(begin, end, k), x, z, found->u);
        for (const int *i = moving_limits; *i >= 0; i++)
            values[*i][k] = *i < NX ? x[*i] : found->u[*i - NX];
    }
    for (const int *i = moving_limits; *i >= 0; i++) {
        const Span span = span_of(values[*i], found->length);
        found->low[*i] = span.low;
        found->high[*i] = span.high;
        found->slowest[*i] = span.slowest;
        found->fastest[*i] = span.fastest;
    }
}

static void call_bounds(Instance *fmu, const Part *part, Equation *bounds, double low[],
                        double high[]) {
    const double *given[] = {
        &part->begin,  &part->length, part->low, part->high,
        part->slowest, part->fastest, part->u,   fmu->state.values + FIRST_PARAMETER};
    memcpy(fmu->arg, given, sizeof given);
    fmu->res[0] = low;
    fmu->res[1] = high;
    if (!bounds(fmu->arg, fmu->res, fmu->iw, fmu->w, 0)) return;
    for (int k = 0; k < BOUNDED_LIMITS; k++) low[k] = NAN;
}

/* Bounds of the margin of one limit on a part; those of its rate only if they are needed. */
static Spanned enclose_margin(void *margin, double begin, double end) {
    const Margin *self = margin;
    double lows[BOUNDED_LIMITS], slowest[BOUNDED_LIMITS], fastest[BOUNDED_LIMITS];
    Part part;
    int place = 0;
    enclose_part(self, begin, end, &part);
    call_bounds(self->fmu, &part, model_limits, lows, NULL);
    while (bounded_limits[place] != self->limit) place++;
    if (lows[place] >= 0) return (Spanned){lows[place], 0, 0};
    call_bounds(self->fmu, &part, model_limit_rates, slowest, fastest);
    return (Spanned){lows[place], slowest[place], fastest[place]};
}

/* The first times by bounds, of limits that have them; what slides obeys laws of its own. Returns
   whether all times are known. a, b: margins at the ends. */
static bool find_by_bounds(Margin *margin, double begin, double end, const double a[],
                           const double b[], double times[]) {
    double lows[BOUNDED_LIMITS];
    Part part;
    if (is_sliding_now(margin->fmu)) return false;
    enclose_part(margin, begin, end, &part);
    call_bounds(margin->fmu, &part, model_limits, lows, NULL);
    for (int k = 0; k < BOUNDED_LIMITS; k++) {
        const int i = bounded_limits[k];
        int parts = MOST_ENCLOSED;
        margin->limit = i;
        times[i] = INFINITY;
        if (!(a[i] > 0))
            times[i] = begin;
        else if (!(lows[k] >= 0 && b[i] > 0))
            times[i] = first_unproven(measure_margin, enclose_margin, margin, begin, end, a[i],
                                      b[i], &parts);
    }
    return BOUNDED_LIMITS == N_LIMITS;
}
#endif

/* When a motion first leaves each limit in a span; DBL_MAX: never, or it was outside before. */
static void find_leaving(Instance *self, const Motion *motion, double begin, double end,
                         double leaving[]) {
    Margin margin = {self, motion, 0};
    double times[LOOKS + 1] = {begin}, every[LOOKS + 1][N_LIMITS], table[LOOKS + 1];
    bool all = false;
    places_within(begin, end, times + 1);
    for (int i = 0; i < N_LIMITS; i++) leaving[i] = NAN;
    for (int k = 0; k <= LOOKS; k += LOOKS) all_margins(&margin, times[k], every[k]);
#if BOUNDED_LIMITS > 0
    all = find_by_bounds(&margin, begin, end, every[0], every[LOOKS], leaving);
#endif
    for (int k = 1; k < LOOKS && !all; k++) all_margins(&margin, times[k], every[k]);
    for (int i = 0; i < N_LIMITS; i++) {
        margin.limit = i;
        for (int k = 0; k <= LOOKS && !all; k++) table[k] = every[k][i];
        if (isnan(leaving[i]))
            leaving[i] =
                !(table[0] > 0) ? begin : first_outside(measure_margin, &margin, begin, end, table);
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
