/* Coordinate projection: moves a state to where the invariants of the model vanish.
 *
 * project(t, x, u, c) -> (x, change) makes a Newton step of least norm and tells its size.
 *
 * Source  Hairer & Wanner, Solving Ordinary Differential Equations II, 2nd ed. 1996, section VII.2.
 */
#ifndef PROJECTION_H
#define PROJECTION_H

#include "ode.h"

static const double ROOT_OF_ROUNDING = 1e-8; /* such a Newton step leaves an error of rounding */
enum { MOST_CORRECTIONS = 5 };

/* Where CasADi's functions find their arguments, results and memory. */
typedef struct {
    const double **arg;
    double **res;
    long long *iw;
    double *w;
} Work;

/* Moves the state of a time, where u and c are already passed; returns 0 where it has succeeded. */
static inline int project_state(Equations *project, const Work *work, double t, double *x) {
    double moved[NX] = {0}, change = 0;
    work->arg[0] = &t;
    work->arg[1] = x;
    work->res[0] = moved;
    work->res[1] = &change;
    for (int i = 0; i < MOST_CORRECTIONS; ++i) {
        if (project(work->arg, work->res, work->iw, work->w, 0) || !is_finite(moved)) return 1;
        memcpy(x, moved, sizeof moved);
        if (change <= ROOT_OF_ROUNDING) return 0;
    }
    return 1;
}

#endif
