/* Model exchange: what happens between two points of an importer, who looks at the ends of its
   steps only. Between these the states are cubics through their values and derivatives. A relation
   that has left its mode, be it that it has come back, has a negative event indicator from then on,
   so that the importer locates the event as every other one; limits are warned of. */
#ifndef LOOKS_H
#define LOOKS_H

#include "modes.h"

#if HAS_LOOKS

#include <float.h>
#include <math.h>
#include <string.h>

#include "cubic.h"
#include "evaluation.h"
#include "leaps.h"
#include "midway.h"

typedef struct {
    Instance *fmu;
    const Glance *before, *last;
} Gap;

/* On the cubic; inputs move on straight lines. */
static void within_gap(void *gap, double t, double x[], double z[], double u[]) {
    const Gap *self = gap;
    const Glance *a = self->before, *b = self->last;
    const double h = b->time - a->time, s = (t - a->time) / h;
    double rate;
    for (int i = 0; i < NX; i++) x[i] = on_cubic(a->x[i], b->x[i], a->dx[i], b->dx[i], h, s, &rate);
    for (int i = 0; i < NU; i++) u[i] = a->u[i] + s * (b->u[i] - a->u[i]);
    memcpy(z, self->fmu->state.values + FIRST_ALGEBRAIC, NZ * sizeof *z);
}

static void box_of_gap(void *gap, double low[], double high[]) {
    const Gap *self = gap;
    const Glance *a = self->before, *b = self->last;
    for (int i = 0; i < NX; i++)
        box_of_cubic(a->x[i], b->x[i], a->dx[i], b->dx[i], b->time - a->time, &low[i], &high[i]);
}

/* Warn of limits that the motion has left and come back to between the last two looks; an importer
   locates the others. */
static void warn_of_limits(Instance *self) {
#if BOUNDED_LIMITS > 0
    Looks *looks = &self->state.looks;
    double leaving[N_LIMITS], margins[N_LIMITS];
    if (looks->count < 2 || looks->seen > 0) return;
    looks->seen = 1;
    Gap gap = {self, &looks->before, &looks->last};
    const Motion motion = {.solver = &gap, .at = within_gap, .box = box_of_gap};
    find_leaving(self, &motion, looks->before.time, looks->last.time, leaving);
    if (!margins_on(self, &motion, looks->last.time, margins)) return;
    for (int i = 0; i < N_LIMITS; i++)
        if (!(margins[i] > 0)) leaving[i] = DBL_MAX;
    note_leaving(self, looks->last.time, leaving);
#else
    (void)self;
#endif
}

/* Warn of a relation that has left its mode where the importer does not stop. */
static void warn_of_passing(Instance *self) {
#if N_WATCHED > 0
    Looks *looks = &self->state.looks;
    const int relation = (int)looks->relation - 1;
    if (relation < 0 || looks->warned[relation] > 0) return;
    looks->warned[relation] = 1;
    log_text(self, WARNING,
             "'%s' switches at %.12g s and returns within a step of the importer, which passes "
             "over it; give it a shorter step",
             relation_names[relation], looks->left);
#else
    (void)self;
#endif
}

/* Note the present point. An importer that goes on to a later one has accepted the former; one that
   goes back tries where an event is. False where there are no derivatives. */
static bool note_look(Instance *self) {
    const double *values = self->state.values, now = values[TIME];
    Looks *looks = &self->state.looks;
    const bool again = looks->count > 0 && now == looks->last.time &&
                       memcmp(looks->last.x, values + FIRST_STATE, NX * sizeof *values) == 0;
    note_inputs(self, again);
    if (!has_derivatives(self)) return false;
    if (looks->count > 0 && now > looks->last.time) {
        warn_of_passing(self);
        warn_of_limits(self);
        looks->before = looks->last;
        looks->count = 2;
    } else if (looks->count < 2 || !(now > looks->before.time)) {
        looks->count = 1;
    }
    if (!again) {
        looks->seen = looks->relation = 0;
        memset(looks->last.inside, 0, sizeof looks->last.inside);
    }
    looks->last.time = now;
    memcpy(looks->last.x, values + FIRST_STATE, NX * sizeof *values);
    memcpy(looks->last.dx, values + FIRST_DERIVATIVE, NX * sizeof *values);
    memcpy(looks->last.u, values + FIRST_INPUT, NU * sizeof *values);
    return true;
}

/* After an event, what was before is another motion; an importer that located an event of a
   relation did so where that left its mode. */
static void forget_looks(Instance *self) {
    Looks *looks = &self->state.looks;
#if N_WATCHED > 0
    const double t = self->state.values[TIME];
    if (t - looks->left > SAME_TIME * time_scale(&self->state.switching, t)) warn_of_passing(self);
#endif
    looks->count = looks->relation = 0;
}

#if N_WATCHED > 0
/* Whether bounds prove that no relation has left its mode between the last two looks. */
static bool stays_between_looks(Instance *self) {
    const Glance *a = &self->state.looks.before, *b = &self->state.looks.last;
    const Laws laws = laws_of(self);
    const double length = b->time - a->time;
    double z[ROOM(NZ)] = {0}, u[ROOM(NU)];
    Spans spans;
    memcpy(u, b->u, sizeof u);
    clear_spans(&spans);
    for (int i = 0; i < NX; i++)
        span_cubic(a->x[i], b->x[i], (const double[]){a->dx[i], b->dx[i]}, length, 0, i, &spans);
    for (int i = 0; i < NU - MODES; i++) {
        const double rate = (b->u[i] - a->u[i]) / length;
        span_cubic(a->u[i], b->u[i], (const double[]){rate, rate}, length, 0, NX + i, &spans);
    }
    return stays_within(&laws, &self->state.switching, &(Point){a->time, a->x, z, u}, length,
                        &spans, a->inside, b->inside);
}

/* Lets the indicator of the first relation that has left its mode since the last look tell so. */
static void look_between(Instance *self, double insides[]) {
    Looks *looks = &self->state.looks;
    int places[MODES];
    bool all = true;
    looks->relation = 0;
    for (int i = 0, k = 0; i < MODES; i++) {
        if (relation_table[i].of_time) continue;
        looks->last.inside[i] = insides[k];
        all &= insides[k] >= 0;
        places[i] = k++;
    }
    if (!all || looks->count < 2) return;
    if (ENCLOSED == N_WATCHED && stays_between_looks(self)) return;
    Gap gap = {self, &looks->before, &looks->last};
    const Motion motion = {.solver = &gap, .at = within_gap};
    const double now = looks->last.time;
    Place place;
    const int i = left_between(self, &motion, looks->before.time, now, &place);
    if (i < 0) return;
    looks->relation = 1 + i;
    looks->left = place.t;
    insides[places[i]] = fmin(place.rates[i] * (now - place.t), -DBL_MIN);
}
#else
#define look_between(self, insides) ((void)(self), (void)(insides))
#endif

#endif

#endif
