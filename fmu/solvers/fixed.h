/* Explicit Runge-Kutta method with steps of one size within each output interval. */
#ifndef FIXED_H
#define FIXED_H

#include "interrupt.h"
#include "quintic.h"
#include "watch.h"

enum { MOST_STAGES = 16 };

/* The coefficients as straight-line code, which is generated. */
typedef struct {
    int order, stages;
    const double *node;
    void (*sum)(int row, const double (*k)[NX], double *sum); /* row `stages`: of the step */
} Method;

static const Method method;

/* One step; `first` is the first stage whose slope is not known. Returns 0 where it succeeds. */
static inline int step_of_method(Problem *self, double t, double h, int first, double (*k)[NX],
                                 double *x) {
    double sum[NX], y[NX];
    for (int s = first; s < method.stages; ++s) {
        method.sum(s, (const double (*)[NX])k, sum);
        for (int i = 0; i < NX; ++i) y[i] = x[i] + h * sum[i];
        if (equations_at(self, t + method.node[s] * h, y, k[s], NULL)) return 1;
    }
    method.sum(method.stages, (const double (*)[NX])k, sum);
    for (int i = 0; i < NX; ++i) x[i] += h * sum[i];
    return 0;
}

/* A step that was made, from state and slope at its start to those at its end. */
typedef struct {
    Problem *problem;
    double x[NX], slope[NX];
    Quintic quintic;
} Made;

static inline int within_made(void *made, double t, double *x, double *dx) {
    const Made *self = made;
    on_quintic(&self->quintic, t, x, dx);
    return 0;
}

static inline int step_shorter(void *made, double t, double *x) {
    const Made *self = made;
    const double begin = self->quintic.t;
    double k[MOST_STAGES][NX];
    memcpy(x, self->x, sizeof self->x);
    memcpy(k[0], self->slope, sizeof k[0]);
    return (t > begin && step_of_method(self->problem, begin, t - begin, 1, k, x)) ||
           restore(self->problem, t, x);
}

/* Integrates x over the grid. Returns one of the codes. */
static inline int integrate_fixed(Problem *self, const Grid *grid, double *x, Course *course) {
    double k[MOST_STAGES][NX], slope_ahead[NX];
    Watch *watch = MODES > 0 ? self->watch : NULL;
    Made made = {.problem = self};
    Place here, ahead;
    double begin = grid->begin;
    if (grid->first && equations_at(self, begin, x, k[0], grid->first)) return NOT_FINITE;
    if (watch && look_afresh(watch, begin, x, made.slope, &here)) return NOT_FINITE;
    for (long long next = 0; next < grid->points || begin < grid->end;) {
        const bool written = next < grid->points;
        const double goal = written ? grid->times[next] : grid->end, length = goal - begin;
        const double parts = fmax(1, ceil(length / grid->largest * (1 - 1e-12)));
        const double h = length / parts;
        int passed = 0;
        course->last = h;
        for (double part = 0; part < parts && !passed; ++part) {
            const double t = begin + part * h, end = part + 1 < parts ? t + h : goal;
            course->reached = t;
            if (halted) return HALTED;
            if (watch) {
                memcpy(made.x, x, sizeof made.x);
                memcpy(k[0], made.slope, sizeof made.slope);
            }
            if (step_of_method(self, t, h, watch != NULL, k, x) || !is_finite(x)) return NOT_FINITE;
            if (restore(self, end, x)) return NOT_PROJECTED;
            ++self->steps;
            if (!watch) continue;
            made.quintic = (Quintic){.t = t,
                                     .h = end - t,
                                     .ends = {made.x, x},
                                     .slopes = {made.slope, slope_ahead},
                                     .slope = problem_slope,
                                     .owner = self,
                                     .looks = looks_for(method.order)};
            if (look_afresh(watch, end, x, slope_ahead, &ahead)) return NOT_FINITE;
            Step step = {.watch = watch,
                         .t = t,
                         .end = grid->end,
                         .beyond = grid->turns ? BUT_INPUTS : BY_EVENTS,
                         .motion = &made,
                         .within = within_made,
                         .step_to = step_shorter,
                         .slopes = k[0],
                         .stages = method.stages,
                         .quintic = &made.quintic};
            Crossing crossing;
            if (crossing_of(&step, made.x, grid->times + next, grid->states + next * NX, &here,
                            &ahead, &crossing))
                return NOT_FINITE;
            if (crossing.relation >= 0) {
                course->reached = crossing.time;
                if (pass_event(watch, &crossing, step.fresh, false))
                    return ends_run(watch, &crossing, step.fresh, x);
                passed = 1;
                begin = crossing.time;
                memcpy(x, step.fresh, sizeof made.x);
                if (look_afresh(watch, begin, x, made.slope, &here)) return NOT_FINITE;
                continue;
            }
            let_go(watch, end, x);
            memcpy(made.slope, slope_ahead, sizeof slope_ahead);
            here = ahead;
        }
        if (passed && goal > begin) continue;
        begin = goal;
        if (written && write_column(self, grid, next++, x, course)) return NOT_FINITE;
    }
    course->reached = grid->end;
    return SUCCESS;
}

#endif
