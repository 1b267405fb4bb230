/* The pair of dop853.h over a grid of output times. */
#ifndef ADAPTIVE_H
#define ADAPTIVE_H

#include <float.h>

#include "dop853.h"
#include "interrupt.h"
#include "projection.h"

enum { MOST_STEPS = 100000 }; /* per output interval */

/* Integrates x over the grid; `out` takes a column per output time. Returns one of the codes. */
static inline int integrate_adaptive(Problem *self, const Grid *grid, double *out, double *z,
                                     Course *course) {
    const Ode ode = {problem_slope, problem_scale, self};
    Slopes k;
    Interpolant piece;
    double x[NX], end[NX], t = grid->times[0];
    const double stop = grid->times[grid->points - 1];
    long long next = 1, trials = 0;
    int rejected = 0;
    memcpy(x, out, sizeof x);
    if (equations_at(self, t, x, k[0], z) || !is_finite(k[0])) return NOT_FINITE;
    double h = fmin(first_step(&ode, t, stop - t, x, k), grid->largest);
    while (next < grid->points) {
        course->reached = t;
        course->last = h;
        if (halted) return HALTED;
        if (++trials > MOST_STEPS) return TOO_MANY_STEPS;
        if (0.1 * h <= fabs(t) * DBL_EPSILON || h < 1e-18 * (stop - grid->times[0]))
            return STEP_TOO_SMALL;
        const int final = t + 1.01 * h >= stop;
        if (final) h = stop - t;
        const int lost = stages(&ode, t, h, x, k, end);
        const double error = lost ? NAN : error_of(&ode, h, x, end, k);
        const double after = final ? stop : t + h;
        if (!(error <= 1) || restore(self, after, end) || slope(&ode, after, end, k[END]) ||
            !is_finite(k[END])) {
            h *= error > 1 ? growth(error, rejected) : 0.1;
            rejected = 1;
            continue;
        }
        ++self->steps;
        if (grid->times[next] < after && interpolate(&ode, t, h, x, end, k, &piece))
            return NOT_FINITE;
        for (; next < grid->points && grid->times[next] <= after; ++next, trials = 0) {
            double *column = out + next * NX;
            if (grid->times[next] < after) {
                evaluate(&piece, grid->times[next], column);
                if (restore(self, grid->times[next], column) || !is_finite(column))
                    return NOT_FINITE;
            } else {
                memcpy(column, end, sizeof end);
            }
            if (z && equations_at(self, grid->times[next], column, k[1], z + next * NZ))
                return NOT_FINITE;
            ++course->passed;
        }
        memcpy(x, end, sizeof x);
        memcpy(k[0], k[END], sizeof k[0]);
        t = after;
        h = fmin(h * growth(error, rejected), grid->largest);
        rejected = 0;
    }
    course->reached = t;
    return SUCCESS;
}

#endif
