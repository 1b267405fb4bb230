/* Coordinate projection: moves a state to where the invariants of the model vanish.
 *
 * project(t, x, u, c) -> (x, change) makes a Newton step of least norm and tells its size.
 *
 * Source  Hairer & Wanner, Solving Ordinary Differential Equations II, 2nd ed. 1996, section VII.2.
 */
#ifndef PROJECTION_H
#define PROJECTION_H

#include "problem.h"

static const double ROOT_OF_ROUNDING = 1e-8; /* such a Newton step leaves an error of rounding */
enum { MOST_CORRECTIONS = 5 };

/* Moves the state of a time; returns 0 where it has succeeded. */
static inline int restore(const Problem *self, double t, double *x) {
    double moved[NX], change = 0;
    if (!self->project) return 0;
    for (int i = 0; i < MOST_CORRECTIONS; ++i) {
        self->arg[0] = &t;
        self->arg[1] = x;
        self->arg[2] = self->u;
        self->arg[3] = self->c;
        self->res[0] = moved;
        self->res[1] = &change;
        if (self->project(self->arg, self->res, self->iw, self->w, 0) || !isfinite(change))
            return 1;
        memcpy(x, moved, sizeof moved);
        if (change <= ROOT_OF_ROUNDING) return 0;
    }
    return 1;
}

#endif
