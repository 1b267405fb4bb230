/* The pair of dop853.h over a grid of output times. */
#ifndef ADAPTIVE_H
#define ADAPTIVE_H

#include <float.h>

#include "dop853.h"
#include "interrupt.h"
#include "watch.h"

enum { MOST_STEPS = 100000 }; /* per output interval */

enum { STEPS_PER_TEST = 1000, MOST_STIFF = 15, MOST_OTHER = 6 };
static const double STABLE = 6.1; /* step times eigenvalue, at the border of stability */

/* A run on its way over a grid, from t on; `after` is where the present step ends. */
typedef struct {
    Problem *problem;
    const Grid *grid;
    Course *course;
    Watch *watch; /* NULL without relations */
    Ode ode;
    double *x, end[NX], t, after, h, error;
    Slopes k;
    Interpolant piece; /* of the present step, as soon as it is needed: then it is known */
    int known;
    double fresh_error; /* of the last fresh step */
    Step step;
    Place here, ahead; /* relations at t, and at the end of the step */
    long long next;    /* output time to be written */
    long long trials;  /* since the last one */
    int rejected;      /* whether the last step was */
} Adaptive;

static inline int interpolated(Adaptive *self) {
    if (!self->known &&
        interpolate(&self->ode, self->t, self->h, self->x, self->end, self->k, &self->piece))
        return 1;
    self->known = 1;
    return 0;
}

static inline int within_accepted(void *adaptive, double t, double *x, double *dx) {
    Adaptive *self = adaptive;
    if (interpolated(self)) return 1;
    evaluate_both(&self->piece, t, x, dx);
    return 0;
}

static inline int step_afresh(void *adaptive, double t, double *x) {
    Adaptive *self = adaptive;
    return fresh_step(&self->ode, self->t, t, self->x, self->k, x, &self->fresh_error) ||
           restore(self->problem, t, x);
}

/* Whether stability limits the steps rather than accuracy, as Hairer's code finds out. */
static inline int is_stiff(Adaptive *self) {
    Problem *problem = self->problem;
    if (!problem->leaves_stiff || (problem->steps % STEPS_PER_TEST != 0 && problem->stiff == 0))
        return 0;
    if (stiffness_of(&self->ode, self->h, self->x, self->end, self->k) > STABLE) {
        problem->other = 0;
        return ++problem->stiff == MOST_STIFF;
    }
    if (++problem->other == MOST_OTHER) problem->stiff = 0;
    return 0;
}

/* Prepares the first step from the present state; its unknowns are written unless NULL. */
static inline int begin_steps(Adaptive *self, double *unknowns) {
    double *const slope_at = self->k[0];
    if (equations_at(self->problem, self->t, self->x, slope_at, unknowns) || !is_finite(slope_at))
        return NOT_FINITE;
    if (self->watch && look_afresh(self->watch, self->t, self->x, self->k[END], &self->here))
        return NOT_FINITE;
    const double first =
        first_step(&self->ode, self->t, self->grid->end - self->t, self->x, self->k);
    self->h = fmin(first, self->grid->largest);
    self->rejected = 0;
    return SUCCESS;
}

/* Makes a step of the present size, or to the end. Returns whether its error is small enough; if
 * not, the size is that of the next trial. */
static inline int propose(Adaptive *self) {
    Problem *problem = self->problem;
    double *const end = self->end;
    self->error = try_step(&self->ode, self->t, self->h, self->grid->end, self->x, self->k,
                           &self->after, end);
    self->h = self->after - self->t;
    if (!(self->error <= 1) || restore(problem, self->after, end) ||
        slope(&self->ode, self->after, end, self->k[END]) || !is_finite(self->k[END])) {
        self->h = smaller_size(self->h, self->error, self->rejected);
        self->rejected = 1;
        return 0;
    }
    ++problem->steps;
    self->known = 0;
    return 1;
}

/* Finds the first crossing in the accepted step, which then ends there. */
static inline int find_event(Adaptive *self, Crossing *found) {
    Watch *watch = self->watch;
    double z[NZ + 1];
    self->step.t = self->t;
    if ((NZ > 0 && equations_at(self->problem, self->after, self->end, self->k[END], z)) ||
        look(watch, self->after, self->end, z, self->k[END], &self->ahead) ||
        crossing_of(&self->step, self->x, self->grid->times + self->next,
                    self->grid->states + self->next * NX, &self->here, &self->ahead, found))
        return NOT_FINITE;
    return SUCCESS;
}

/* A fresh step to a crossing is not accurate enough: the step has passed over a change. */
static inline void shorten(Adaptive *self, const Crossing *crossing) {
    self->h = (crossing->time - self->t) * growth(self->fresh_error, 1);
    self->rejected = 1;
    --self->problem->steps;
}

/* Writes the output times up to the end of the step; one at a crossing follows the event. */
static inline int write_rows(Adaptive *self, bool crossed) {
    const Grid *grid = self->grid;
    const double after = self->after;
    const long long first = self->next;
    if (first < grid->points && grid->times[first] < after && interpolated(self)) return NOT_FINITE;
    for (; self->next < grid->points && grid->times[self->next] <= after; ++self->next) {
        const double t = grid->times[self->next];
        double *const column = grid->states + self->next * NX;
        if (crossed && t == after) break;
        if (t < after) {
            if (grid->times + self->next >= self->step.looked) evaluate(&self->piece, t, column);
            if (!is_finite(column)) return NOT_FINITE;
            if (restore(self->problem, t, column)) return NOT_PROJECTED;
        }
        if (write_column(self->problem, grid, self->next, t < after ? column : self->end,
                         self->course))
            return NOT_FINITE;
        self->trials = 0;
    }
    return SUCCESS;
}

/* Goes on after the event at a crossing, or ends the run there. */
static inline int cross(Adaptive *self, const Crossing *crossing) {
    const Grid *grid = self->grid;
    double *const fresh = self->step.fresh;
    self->course->reached = self->after;
    if (pass_event(self->watch, crossing, fresh, false))
        return ends_run(self->watch, crossing, fresh, self->x);
    self->t = self->after;
    memcpy(self->x, fresh, NX * sizeof *fresh);
    if (begin_steps(self, NULL)) return NOT_FINITE;
    if (self->next < grid->points && grid->times[self->next] <= self->t)
        write_event(self->problem, grid, self->next++, self->x, self->course);
    return SUCCESS;
}

/* Goes on from the end of the step. */
static inline void move_on(Adaptive *self) {
    memcpy(self->x, self->end, sizeof self->end);
    memcpy(self->k[0], self->k[END], sizeof self->k[0]);
    self->t = self->after;
    self->h = fmin(self->h * growth(self->error, self->rejected), self->grid->largest);
    self->rejected = 0;
}

/* Integrates x over the grid. Returns one of the codes. */
static inline int integrate_adaptive(Problem *problem, const Grid *grid, double *x,
                                     Course *course) {
    Adaptive self = {.problem = problem,
                     .grid = grid,
                     .course = course,
                     .watch = MODES > 0 ? problem->watch : NULL,
                     .ode = {problem_slope, problem_scale, problem},
                     .x = x,
                     .t = grid->begin};
    Watch *watch = self.watch;
    const double stop = grid->end;
    self.step = (Step){.watch = watch,
                       .end = stop,
                       .beyond = grid->turns ? BUT_INPUTS : BY_EVENTS,
                       .motion = &self,
                       .within = within_accepted,
                       .step_to = step_afresh,
                       .slopes = self.k[0],
                       .stages = END + 1,
                       .looked = grid->times};
    if (begin_steps(&self, grid->first)) return NOT_FINITE;
    while (self.t < stop) {
        course->reached = self.t;
        course->last = self.h;
        if (halted) return HALTED;
        if (++self.trials > MOST_STEPS) return TOO_MANY_STEPS;
        if (watch && stop - self.t <= 10 * DBL_EPSILON * fabs(stop)) { /* as after an event */
            for (; self.next < grid->points; ++self.next) {
                move_along(x, self.k[0], grid->times[self.next] - self.t, self.end);
                if (write_column(problem, grid, self.next, self.end, course)) return NOT_FINITE;
            }
            move_along(x, self.k[0], stop - self.t, x);
            break;
        }
        if (0.1 * self.h <= fabs(self.t) * DBL_EPSILON || self.h < 1e-18 * (stop - grid->begin))
            return STEP_TOO_SMALL;
        if (!propose(&self)) continue;
        if (is_stiff(&self)) return STIFF;
        Crossing crossing = {self.after, -1, self.after};
        if (watch && find_event(&self, &crossing)) return NOT_FINITE;
        const bool crossed = crossing.relation >= 0;
        if (crossed && !(self.fresh_error <= 1)) {
            shorten(&self, &crossing);
            continue;
        }
        if (watch && !crossed) let_go(watch, self.after, self.end);
        self.after = crossing.time;
        if (watch) self.here = self.ahead;
        const int written = write_rows(&self, crossed);
        if (written) return written;
        if (!crossed) {
            move_on(&self);
            continue;
        }
        const int code = cross(&self, &crossing);
        if (code != SUCCESS) return code;
    }
    course->reached = stop;
    return SUCCESS;
}

#endif
