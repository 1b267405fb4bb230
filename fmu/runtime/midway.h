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
#include "quintic.h"
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

static bool is_left(const Instance *self, int limit) {
    return self->state.outside[limit] > 0;
}

static void all_margins(const Margin *self, double t, double margins[]) {
    if (!margins_on(self->fmu, self->motion, t, margins))
        for (int i = 0; i < N_LIMITS; i++) margins[i] = INFINITY; /* the equations failed */
}

static void look_at_limit(void *margin, double t, Place *found) {
    const Margin *self = margin;
    double every[N_LIMITS];
    sharpen_fully(self->motion->quintic);
    all_margins(self, t, every);
    note_no_event(t, found);
    found->inside[0] = every[self->limit] > 0 ? every[self->limit] : -DBL_MIN;
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
    const double *given[] = {&part->begin,  &part->length, part->low, part->high,
                             part->slowest, part->fastest, part->u,   fmu->constants};
    memcpy(fmu->arg, given, sizeof given);
    fmu->res[0] = low;
    fmu->res[1] = high;
    if (!bounds(fmu->arg, fmu->res, fmu->iw, fmu->w, 0)) return;
    for (int k = 0; k < BOUNDED_LIMITS; k++) low[k] = NAN;
}

/* Whether a limit holds on a part at whose ends it does. The rates, which are dear, are enclosed
   only if the values prove nothing. */
static bool holds_between(void *margin, const Place *a, const Place *b) {
    const Margin *self = margin;
    double lows[BOUNDED_LIMITS], slowest[BOUNDED_LIMITS], fastest[BOUNDED_LIMITS];
    Part part;
    int k = 0;
    while (bounded_limits[k] != self->limit) k++;
    enclose_part(self, a->t, b->t, &part);
    call_bounds(self->fmu, &part, model_limits, lows, NULL);
    if (lows[k] >= 0) return true;
    call_bounds(self->fmu, &part, model_limit_rates, slowest, fastest);
    const Spanned span = {lows[k], slowest[k], fastest[k]};
    return stays_positive(&span, a->inside[0], b->inside[0], part.length);
}

/* Whether bounds prove that all limits that have them, and have not been left, hold on a motion: in
   the box of states in which they have been proven to, that box made wider, or that of the motion.
 */
static bool hold_in_box(const Margin *self, double begin, double end) {
    Instance *fmu = self->fmu;
    Proven *proven = &fmu->proven;
    const double *values = fmu->state.values, *given = values + FIRST_PARAMETER - MODES;
    const double *left = fmu->state.outside;
    const bool known = proven->known &&
                       memcmp(left, proven->outside, sizeof proven->outside) == 0 &&
                       memcmp(given, proven->given, (MODES + NP) * sizeof *given) == 0;
    bool holds = known && begin >= proven->begin && end <= proven->end;
    double low[ROOM(NX)], high[ROOM(NX)], lows[BOUNDED_LIMITS];
    Part part;
    if (!self->motion->box) return false;
    self->motion->box(self->motion->solver, low, high);
    for (const int *i = moving_limits; *i >= 0; i++) {
        if (*i >= NX) return false;
        holds &= low[*i] >= proven->low[*i] && high[*i] <= proven->high[*i];
    }
    memcpy(part.u, values + FIRST_INPUT, NU * sizeof *values);
    for (int trial = !known; !holds && trial < 2; trial++) {
        part.begin = trial ? begin : fmin(begin, proven->begin);
        part.length = LIMITS_OF_TIME ? 2 * (end - part.begin) : INFINITY;
        for (const int *i = moving_limits; *i >= 0; i++) {
            const double least = trial ? low[*i] : fmin(low[*i], proven->low[*i]);
            const double most = trial ? high[*i] : fmax(high[*i], proven->high[*i]);
            const double more = trial ? 0 : WIDER * (most - least);
            part.low[*i] = least - more;
            part.high[*i] = most + more;
        }
        call_bounds(fmu, &part, model_limits, lows, NULL);
        holds = true;
        for (int k = 0; k < BOUNDED_LIMITS; k++)
            holds &= lows[k] >= 0 || is_left(fmu, bounded_limits[k]);
        if (!holds) continue;
        proven->known = true;
        memcpy(proven->outside, left, sizeof proven->outside);
        proven->begin = part.begin;
        proven->end = part.begin + part.length;
        memcpy(proven->low, part.low, NX * sizeof *low);
        memcpy(proven->high, part.high, NX * sizeof *high);
        memcpy(proven->given, given, (MODES + NP) * sizeof *given);
    }
    return holds;
}

/* When a motion first leaves each limit that has bounds. */
static void find_by_bounds(Margin *margin, double begin, double end, double times[]) {
    const bool hold = hold_in_box(margin, begin, end);
    for (int k = 0; k < BOUNDED_LIMITS; k++) {
        const int i = margin->limit = bounded_limits[k];
        times[i] = hold || is_left(margin->fmu, i)
                       ? INFINITY
                       : first_crossing(look_at_limit, holds_between, margin, begin, end);
    }
}
#endif

static int looks_left(const Motion *motion) {
    return motion->quintic ? motion->quintic->looks : 0;
}

/* When a motion first leaves each limit in a span; DBL_MAX: never, or it was outside before. What
   slides obeys laws of its own, without bounds. */
static void find_leaving(Instance *self, const Motion *motion, double begin, double end,
                         double leaving[]) {
    Margin margin = {self, motion, 0};
    double times[LOOKS + 1] = {begin}, every[LOOKS + 1][N_LIMITS], table[LOOKS + 1];
    int looks = 0;
    for (int i = 0; i < N_LIMITS; i++) leaving[i] = NAN;
#if BOUNDED_LIMITS > 0
    if (!is_sliding_now(self)) find_by_bounds(&margin, begin, end, leaving);
#endif
    places_within(begin, end, times + 1);
    for (int i = 0; i < N_LIMITS; i++) {
        margin.limit = i;
        while (isnan(leaving[i])) {
            const int left = looks_left(motion);
            for (; looks <= LOOKS; looks++) all_margins(&margin, times[looks], every[looks]);
            for (int k = 0; k < looks; k++) table[k] = every[k][i];
            leaving[i] =
                !(table[0] > 0) ? begin : first_outside(look_at_limit, &margin, begin, end, table);
            if (leaving[i] == INFINITY || looks_left(motion) == left) continue;
            looks = 0; /* the motion is more accurate now */
            leaving[i] = NAN;
        }
        if (is_left(self, i) || leaving[i] == INFINITY) leaving[i] = DBL_MAX;
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
#define find_leaving(self, motion, begin, end, leaving)                                            \
    ((void)(self), (void)(motion), (void)(begin), (void)(end), (void)(leaving))
#define note_leaving(self, time, leaving) ((void)(self), (void)(time), (void)(leaving))
#endif

#endif
