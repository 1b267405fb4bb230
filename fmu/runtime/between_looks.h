/* Model exchange: whether a relation has left its mode since the event indicators were looked at
   last, be it that it has come back. Importers look at the ends of their steps. Between two looks
   the states are cubics through their values and derivatives; bounds over these prove that every
   relation stays, or tell where one leaves. From there on its indicator is negative, so that the
   importer locates the event as every other one. */
#ifndef BETWEEN_LOOKS_H
#define BETWEEN_LOOKS_H

#include "state.h"

#if ENCLOSED > 0

#include <float.h>
#include <math.h>
#include <string.h>

#include "glance.h"

static void warn_of_passing(Instance *self) {
    Looks *looks = &self->state.looks;
    const int relation = (int)looks->relation - 1;
    if (relation < 0 || looks->warned[relation] > 0) return;
    looks->warned[relation] = 1;
    log_text(self, WARNING,
             "'%s' switches at %.12g s and returns within a step of the importer, which passes "
             "over it; give it a shorter step",
             relation_names[relation], looks->left);
}

/* After an event; one that located an event of a relation did so where that left its mode. */
static void forget_looks(Instance *self) {
    const double t = self->state.values[TIME];
    Looks *looks = &self->state.looks;
    if (t - looks->left > SAME_TIME * time_scale(&self->state.switching, t)) warn_of_passing(self);
    looks->count = looks->relation = 0;
}

/* An importer that looks at an earlier time than before tries where an event is; one that goes on
   to a later time has accepted the former. */
static void note_look(Instance *self) {
    const double *values = self->state.values;
    Looks *looks = &self->state.looks;
    if (looks->count > 0 && values[TIME] > looks->last.time) {
        warn_of_passing(self);
        looks->before = looks->last;
        looks->count = 2;
    } else if (looks->count < 2 || !(values[TIME] > looks->before.time)) {
        looks->count = 1;
    }
    looks->relation = 0;
    take_glance(self, &looks->last);
}

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
static Status look_between(Instance *self, double insides[]) {
    Looks *looks = &self->state.looks;
    int places[MODES];
    bool all = true;
    if (self->state.mode != CONTINUOUS_TIME_MODE) return OK;
    const Status status = refresh(self, DERIVATIVES);
    if (status != OK) return status;
    note_look(self);
    for (int i = 0, k = 0; i < MODES; i++) {
        if (relation_table[i].of_time) continue;
        looks->last.inside[i] = insides[k];
        all &= insides[k] >= 0;
        places[i] = k++;
    }
    if (!all || looks->count < 2 || stays_between_looks(self)) return OK;
    Gap gap = {self, &looks->before, &looks->last};
    const Motion motion = {&gap, within_gap, NULL};
    const double now = looks->last.time;
    Place place;
    const int i = left_between(self, &motion, looks->before.time, now, &place);
    if (i < 0) return OK;
    looks->relation = 1 + i;
    looks->left = place.t;
    insides[places[i]] = fmin(place.rates[i] * (now - place.t), -DBL_MIN);
    return OK;
}

#endif

#endif
