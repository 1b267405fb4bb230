/* The relations of the equations, looked at as a solver goes: a step in which one leaves its mode
 * ends exactly there.
 *
 * watch(t, x, z, u, c, dx) -> (inside, rates): how far every relation is within its mode, and the
 * rate of that, at solved unknowns z.
 */
#ifndef WATCH_H
#define WATCH_H

#include "crossings.h"
#include "projection.h"

/* A step that was accepted: its states within it, a fresh step to a time in it. */
typedef struct {
    Problem *problem;
    double t, h;
    void *motion;
    int (*within)(void *motion, double t, double *x, double *dx);
    int (*step_to)(void *motion, double t, double *x);
    const double *looked; /* the output times before it have been looked at */
} Step;

/* Margins at a state; what is 0 at the start of a run by definition counts from there. */
static inline int margins_at(Problem *self, double t, const double *x, double *z, const double *dx,
                             Place *found) {
    found->t = t;
    self->arg[0] = &t;
    self->arg[1] = x;
    self->arg[2] = z;
    self->arg[3] = self->u;
    self->arg[4] = self->c;
    self->arg[5] = dx;
    self->res[0] = found->inside;
    self->res[1] = found->rates;
    if (self->watch(self->arg, self->res, self->iw, self->w, 0)) return 1;
    for (int i = 0; i < RELATIONS; ++i) {
        if (!self->looked_at && self->stays[i] >= 0) self->offsets[i] = found->inside[i];
        found->inside[i] -= self->offsets[i];
    }
    self->looked_at = 1;
    return 0;
}

/* The same; what the equations keep at 0 does not leave it, wherever the solver's motion goes. */
static inline int look(Problem *self, double t, const double *x, double *z, const double *dx,
                       Place *found) {
    Place exact = {.t = NAN};
    double slopes[NX], solved[NZ + 1];
    if (margins_at(self, t, x, z, dx, found)) return 1;
    for (int i = 0; i < RELATIONS; ++i) {
        if (!(self->stays[i] > 0 && found->inside[i] < 0)) continue;
        if (exact.t != t && (equations_at(self, t, x, slopes, solved) ||
                             margins_at(self, t, x, solved, slopes, &exact)))
            return 1;
        if (fabs(exact.rates[i]) <= self->stays[i]) found->inside[i] = 0;
    }
    return 0;
}

/* The same where the derivatives and the algebraic unknowns are not known yet. */
static inline int look_afresh(Problem *self, double t, const double *x, double *dx, Place *found) {
    double z[NZ + 1];
    return equations_at(self, t, x, dx, z) || look(self, t, x, z, dx, found);
}

static inline void look_at(const Step *self, double t, double *x, Place *found) {
    double dx[NX], slopes[NX], z[NZ + 1];
    const int lost = self->within(self->motion, t, x, dx) ||
                     (NZ > 0 && equations_at(self->problem, t, x, slopes, z)) ||
                     look(self->problem, t, x, z, dx, found);
    for (int i = 0; lost && i < RELATIONS; ++i) {
        found->inside[i] = 1;
        found->rates[i] = 0;
    }
    found->t = t;
}

static inline void look_within(void *accepted, double t, Place *found) {
    double x[NX];
    look_at(accepted, t, x, found);
}

/* The first crossing in an accepted step that ends at a place, from the place where it begins: at
 * the output times in it, whose columns take the states, and between all these places. */
static inline Crossing crossing_of(Step *self, const double *times, double *columns,
                                   const Place *begin, const Place *end) {
    Place before = *begin, place;
    self->looked = times;
    for (const double *time = times; before.t < end->t; before = place) {
        while (*time <= before.t && *time < end->t) ++time;
        if (*time < end->t) {
            look_at(self, *time, columns + (time - times) * NX, &place);
            self->looked = time + 1;
        } else {
            place = *end;
        }
        if (!is_suspect(&before, &place)) continue;
        const Crossing found = crossing_between(look_within, self, before, place.t);
        if (found.relation >= 0) return found;
        if (outside(&place) >= 0) return (Crossing){place.t, outside(&place)};
    }
    return (Crossing){end->t, -1};
}

/* The relation that crosses first, near a place: the one that was found, or one that is beyond. */
static inline int first_at(const Place *place, int found) {
    double least = INFINITY;
    int first = found;
    for (int i = 0; i < RELATIONS; ++i) {
        const double rate = place->rates[i], delay = -place->inside[i] / rate;
        const int beyond = place->inside[i] < 8 * DBL_EPSILON * fabs(place->t) * rate;
        if (!(rate < 0) || !(i == found || beyond) || !(delay < least)) continue;
        least = delay;
        first = i;
    }
    return first;
}

/* Ends a step at a crossing: where the ends of such steps cross. */
static inline int end_at(const Step *self, Crossing *crossing, double *x) {
    Bounds bounds = {self->t, self->t + self->h, 0};
    double dx[NX];
    Place place;
    for (int n = 0; n < MOST_TRIALS_OF_A_TIME; ++n) {
        const double t = crossing->time;
        if (self->step_to(self->motion, t, x) || look_afresh(self->problem, t, x, dx, &place))
            return 1;
        const int i = crossing->relation = first_at(&place, crossing->relation);
        crossing->time = better_time(&bounds, t, place.inside[i], place.rates[i]);
        if (crossing->time == t) break;
    }
    return 0;
}

/* Writes the state at a crossing after the last output time that was passed. */
static inline int ends_run(Problem *self, const Crossing *crossing, const double *x, double *out,
                           double *z) {
    double dx[NX];
    memcpy(out, x, NX * sizeof *x);
    if (z && equations_at(self, crossing->time, x, dx, z)) return NOT_FINITE;
    self->relation = crossing->relation;
    return EVENT;
}

#endif
