/* Explicit Runge-Kutta method with steps of one size within each output interval. */
#ifndef FIXED_H
#define FIXED_H

#include "interrupt.h"
#include "projection.h"

enum { MOST_STAGES = 16 };

/* The coefficients as straight-line code, which is generated. */
typedef struct {
    int stages;
    const double *node;
    void (*sum)(int row, const double (*k)[NX], double *sum); /* row `stages`: of the step */
} Method;

static const Method method;

static inline int integrate_fixed(Problem *self, const Grid *grid, double *out, double *z,
                                  Course *course) {
    double k[MOST_STAGES][NX], sum[NX], x[NX], y[NX];
    memcpy(x, out, sizeof x);
    if (z && equations_at(self, grid->times[0], x, k[0], z)) return NOT_FINITE;
    for (long long next = 1; next < grid->points; ++next) {
        const double begin = grid->times[next - 1], length = grid->times[next] - begin;
        const double parts = fmax(1, ceil(length / grid->largest * (1 - 1e-12)));
        const double h = length / parts;
        course->last = h;
        for (double part = 0; part < parts; ++part) {
            const double t = begin + part * h;
            course->reached = t;
            if (halted) return HALTED;
            for (int s = 0; s < method.stages; ++s) {
                method.sum(s, (const double (*)[NX])k, sum);
                for (int i = 0; i < NX; ++i) y[i] = x[i] + h * sum[i];
                if (equations_at(self, t + method.node[s] * h, y, k[s], NULL)) return NOT_FINITE;
            }
            method.sum(method.stages, (const double (*)[NX])k, sum);
            for (int i = 0; i < NX; ++i) x[i] += h * sum[i];
            if (restore(self, part + 1 < parts ? t + h : grid->times[next], x)) return NOT_FINITE;
            ++self->steps;
        }
        if (!is_finite(x)) return NOT_FINITE;
        memcpy(out + next * NX, x, sizeof x);
        if (z && equations_at(self, grid->times[next], x, k[0], z + next * NZ)) return NOT_FINITE;
        ++course->passed;
    }
    course->reached = grid->times[grid->points - 1];
    return SUCCESS;
}

#endif
