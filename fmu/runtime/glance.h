/* Model exchange: the motion between two points of an importer, who tells nothing of it but its
 * ends.
 */
#ifndef GLANCE_H
#define GLANCE_H

#include "state.h"

#if ENCLOSED > 0 || BOUNDED_LIMITS > 0

#include <math.h>
#include <string.h>

#include "cubic.h"
#include "midway.h"

typedef struct {
    Instance *fmu;
    const Glance *before, *last;
} Gap;

/* On the cubic through values and derivatives of the states; inputs move on straight lines. */
static void within_gap(void *gap, double t, double x[], double z[], double u[]) {
    const Gap *self = gap;
    const Glance *a = self->before, *b = self->last;
    const double h = b->time - a->time, s = (t - a->time) / h;
    double rate;
    for (int i = 0; i < NX; i++) x[i] = on_cubic(a->x[i], b->x[i], a->dx[i], b->dx[i], h, s, &rate);
    for (int i = 0; i < NU; i++) u[i] = a->u[i] + s * (b->u[i] - a->u[i]);
    memcpy(z, self->fmu->state.values + FIRST_ALGEBRAIC, NZ * sizeof *z);
}

/* The present point; derivatives must be fresh. */
static void take_glance(const Instance *self, Glance *found) {
    const double *values = self->state.values;
    found->known = 1;
    found->time = values[TIME];
    memcpy(found->x, values + FIRST_STATE, NX * sizeof *values);
    memcpy(found->dx, values + FIRST_DERIVATIVE, NX * sizeof *values);
    memcpy(found->u, values + FIRST_INPUT, NU * sizeof *values);
}

#endif

#if BOUNDED_LIMITS > 0
/* Warn of limits that the motion has left and come back to between the last two points; an importer
   locates the others. */
static void look_at_gap(Instance *self) {
    Glance before = self->state.before_limits, last = self->state.at_limits;
    double leaving[N_LIMITS], margins[N_LIMITS];
    if (before.known == 0 || last.known != 1) return;
    self->state.at_limits.known = 2; /* once */
    Gap gap = {self, &before, &last};
    const Motion motion = {&gap, within_gap, NULL};
    find_leaving(self, &motion, before.time, last.time, leaving);
    if (!margins_on(self, &motion, last.time, margins)) return;
    for (int i = 0; i < N_LIMITS; i++)
        if (!(margins[i] > 0)) leaving[i] = DBL_MAX;
    note_leaving(self, last.time, leaving);
}

/* Note a point. An importer that goes on to a later one has accepted the former; one that goes back
   tries where an event is. */
static void look_at_limits_here(Instance *self) {
    Glance *before = &self->state.before_limits, *last = &self->state.at_limits, now = {0};
    if (refresh(self, DERIVATIVES) != OK) return;
    take_glance(self, &now);
    if (now.time == last->time) now.known = fmax(now.known, last->known);
    if (last->known > 0 && now.time > last->time) {
        look_at_gap(self);
        *before = *last;
    } else if (!(now.time > before->time)) {
        before->known = 0;
    }
    *last = now;
}

/* After an event, what was before is another motion. */
static void begin_looks_at_limits(Instance *self) {
    self->state.at_limits.known = self->state.before_limits.known = 0;
    look_at_limits_here(self);
}
#endif

#endif
