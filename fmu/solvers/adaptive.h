/* The pair of dop853.h over a grid of output times. */
#ifndef ADAPTIVE_H
#define ADAPTIVE_H

#include <float.h>

#include "dop853.h"
#include "interrupt.h"
#include "projection.h"
#include "watch.h"

enum { MOST_STEPS = 100000 }; /* per output interval */

/* An accepted step, and its interpolant as soon as it is needed. */
typedef struct {
    const Ode *ode;
    const double *x, *end;
    double (*k)[NX];
    double t, h;
    Interpolant piece;
    int known;
    double error; /* of the last fresh step */
} Accepted;

static inline int interpolated(Accepted *self) {
    if (!self->known &&
        interpolate(self->ode, self->t, self->h, self->x, self->end, self->k, &self->piece))
        return 1;
    self->known = 1;
    return 0;
}

static inline int within_accepted(void *accepted, double t, double *x, double *dx) {
    Accepted *self = accepted;
    if (interpolated(self)) return 1;
    evaluate_both(&self->piece, t, x, dx);
    return 0;
}

static inline int step_afresh(void *accepted, double t, double *x) {
    Accepted *self = accepted;
    Slopes k;
    memcpy(k[0], self->k[0], sizeof k[0]);
    memcpy(x, self->x, NX * sizeof *x);
    self->error = 0;
    if (t > self->t) {
        if (stages(self->ode, self->t, t - self->t, self->x, k, x)) return 1;
        self->error = error_of(self->ode, t - self->t, self->x, x, k);
    }
    return restore(self->ode->context, t, x);
}

enum { STEPS_PER_TEST = 1000, MOST_STIFF = 15, MOST_OTHER = 6 };
static const double STABLE = 6.1; /* step times eigenvalue, at the border of stability */

/* Whether stability limits the steps rather than accuracy, as Hairer's code finds out. */
static inline int is_stiff(Problem *self, const Accepted *step) {
    if (!self->leaves_stiff || (self->steps % STEPS_PER_TEST != 0 && self->stiff == 0)) return 0;
    if (stiffness_of(step->ode, step->h, step->x, step->end, step->k) > STABLE) {
        self->other = 0;
        return ++self->stiff == MOST_STIFF;
    }
    if (++self->other == MOST_OTHER) self->stiff = 0;
    return 0;
}

/* Integrates x over the grid. Returns one of the codes. */
static inline int integrate_adaptive(Problem *self, const Grid *grid, double *x, Course *course) {
    const Ode ode = {problem_slope, problem_scale, self};
    Slopes k;
    double end[NX], t = grid->begin;
    Watch *watch = MODES > 0 ? self->watch : NULL;
    Accepted accepted = {&ode, x, end, k, t, 0, {0, 0, {{0}}}, 0, 0};
    const double stop = grid->end, *times = grid->times;
    Step step = {.watch = watch,
                 .known = stop,
                 .motion = &accepted,
                 .within = within_accepted,
                 .step_to = step_afresh,
                 .slopes = (const double (*)[NX])k,
                 .stages = END + 1,
                 .looked = times};
    Place here, ahead;
    long long next = 0, trials = 0;
    int rejected = 0;
    if (equations_at(self, t, x, k[0], grid->first) || !is_finite(k[0])) return NOT_FINITE;
    if (watch && look_afresh(watch, t, x, k[END], &here)) return NOT_FINITE;
    double h = fmin(first_step(&ode, t, stop - t, x, k), grid->largest);
    while (t < stop) {
        course->reached = t;
        course->last = h;
        if (halted) return HALTED;
        if (++trials > MOST_STEPS) return TOO_MANY_STEPS;
        if (watch && stop - t <= 10 * DBL_EPSILON * fabs(stop)) { /* as after an event */
            for (; next < grid->points; ++next)
                if (write_column(self, grid, next, x, course)) return NOT_FINITE;
            break;
        }
        if (0.1 * h <= fabs(t) * DBL_EPSILON || h < 1e-18 * (stop - grid->begin))
            return STEP_TOO_SMALL;
        const int final = t + 1.01 * h >= stop;
        if (final) h = stop - t;
        const int lost = stages(&ode, t, h, x, k, end);
        const double error = lost ? NAN : error_of(&ode, h, x, end, k);
        double after = final ? stop : t + h;
        if (!(error <= 1) || restore(self, after, end) || slope(&ode, after, end, k[END]) ||
            !is_finite(k[END])) {
            h *= error > 1 ? growth(error, rejected) : 0.1;
            rejected = 1;
            continue;
        }
        ++self->steps;
        accepted.t = t;
        accepted.h = h;
        accepted.known = 0;
        if (is_stiff(self, &accepted)) return STIFF;
        Crossing crossing = {after, -1, after};
        if (watch) {
            double z_end[NZ + 1];
            step.t = t;
            step.h = after - t;
            if ((NZ > 0 && equations_at(self, after, end, k[END], z_end)) ||
                look(watch, after, end, z_end, k[END], &ahead))
                return NOT_FINITE;
            if (crossing_of(&step, x, times + next, grid->states + next * NX, &here, &ahead,
                            &crossing))
                return NOT_FINITE;
            if (crossing.relation >= 0 && !(accepted.error <= 1)) {
                h = (crossing.time - t) * growth(accepted.error, 1); /* a change was stepped over */
                rejected = 1;
                --self->steps;
                continue;
            }
            if (crossing.relation < 0) let_go(watch, after, end);
            after = crossing.time;
            here = ahead;
        }
        const int crossed = crossing.relation >= 0;
        if (next < grid->points && times[next] < after && interpolated(&accepted))
            return NOT_FINITE;
        for (; next < grid->points && times[next] <= after; ++next, trials = 0) {
            if (crossed && times[next] == after) break;
            double *column = grid->states + next * NX;
            const int inner = times[next] < after;
            if (inner && times + next >= step.looked)
                evaluate(&accepted.piece, times[next], column);
            if (inner && (restore(self, times[next], column) || !is_finite(column)))
                return NOT_FINITE;
            if (write_column(self, grid, next, inner ? column : end, course)) return NOT_FINITE;
        }
        if (crossed) {
            course->reached = after;
            if (pass_event(watch, &crossing, step.fresh, false))
                return ends_run(watch, &crossing, step.fresh, x);
            t = after;
            rejected = 0;
            memcpy(x, step.fresh, sizeof end);
            if (equations_at(self, t, x, k[0], NULL) || !is_finite(k[0]) ||
                look_afresh(watch, t, x, k[END], &here))
                return NOT_FINITE;
            h = fmin(first_step(&ode, t, stop - t, x, k), grid->largest);
            if (next == grid->points || times[next] > t) continue;
            write_event(self, grid, next, x, course);
            ++next;
            continue;
        }
        memcpy(x, end, sizeof end);
        memcpy(k[0], k[END], sizeof k[0]);
        t = after;
        h = fmin(h * growth(error, rejected), grid->largest);
        rejected = 0;
    }
    course->reached = stop;
    return SUCCESS;
}

#endif
