/* dx/dt = f(t, x) as a value, for solvers that know neither the model nor who calls them. */
#ifndef ODE_H
#define ODE_H

#include <math.h>
#include <string.h>

#ifndef NX
#error "define NX, the number of states, before solvers are included"
#endif

/* A function as CasADi writes it. */
typedef int Equations(const double **arg, double **res, long long *iw, double *w, int mem);

/* Gives dx/dt; returns 0 where it has a value. */
typedef int Slope(void *context, double t, const double *x, double *dx);

/* The error that state i may have in a step where it is x. */
typedef double Scale(const void *context, int i, double x);

typedef struct {
    Slope *slope;
    Scale *scale; /* of adaptive methods only */
    void *context;
} Ode;

static inline int slope(const Ode *ode, double t, const double *x, double *dx) {
    return ode->slope(ode->context, t, x, dx);
}

static inline int is_finite(const double *x) {
    double sum = 0;
    for (int i = 0; i < NX; ++i) sum += 0 * x[i]; /* 0 * inf and 0 * nan are nan */
    return sum == 0;
}

/* A state that moves on for so short a time that its motion is a line. */
static inline void move_along(const double *x, const double *dx, double time, double *state) {
    for (int i = 0; i < NX; ++i) state[i] = x[i] + time * dx[i];
}

#endif
