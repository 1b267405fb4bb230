/* The right-hand side as CasADi generates it, called by a solver over a grid and counted. */
#ifndef PROBLEM_H
#define PROBLEM_H

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#include "ode.h"
#include "projection.h"

#if !defined NZ || !defined NU || !defined NC
#error "define NZ, NU and NC: how many algebraic unknowns, inputs and constants there are"
#endif

/* Codes 0 to 3 are those of CasADi's own integrators. */
enum { SUCCESS, TOO_MANY_STEPS, STEP_TOO_SMALL, INCONSISTENT, NOT_FINITE, HALTED, EVENT, STIFF };
enum { NOT_PROJECTED = STIFF + 1 };

typedef struct {
    Equations *rhs;     /* (t, x, z guess, u, c) -> (dx/dt, z) */
    Equations *project; /* see projection.h; NULL where nothing is corrected */
    double *z, *u;      /* what every call is given: the guess, inputs with modes, ... */
    const double *c;    /* ... and constants */
    const double **arg; /* CasADi's work space */
    double **res;
    long long *iw;
    double *w;
    long long steps, calls;
    double relative, absolute; /* error that each step may have, the latter in nominal values */
    const double *nominal;     /* of the states */
    void *watch;               /* see watch.h; NULL without relations */
    int leaves_stiff;          /* whether it ends where it is found to be stiff */
    int stiff, other;          /* numbers of steps that looked so, and then not */
} Problem;

/* dx/dt; the algebraic unknowns, too, where `z` is not NULL. Returns 0 where it has a value. */
static inline int equations_at(Problem *self, double t, const double *x, double *dx, double *z) {
    self->arg[0] = &t;
    self->arg[1] = x;
    self->arg[2] = self->z;
    self->arg[3] = self->u;
    self->arg[4] = self->c;
    self->res[0] = dx;
    self->res[1] = z;
    ++self->calls;
    return self->rhs(self->arg, self->res, self->iw, self->w, 0);
}

/* Moves a state to where the invariants vanish, if there are any; 0 is success. */
static inline int restore(const Problem *self, double t, double *x) {
    if (!self->project) return 0;
    self->arg[2] = self->u;
    self->arg[3] = self->c;
    const Work work = {self->arg, self->res, self->iw, self->w};
    return project_state(self->project, &work, t, x);
}

static inline int problem_slope(void *problem, double t, const double *x, double *dx) {
    return equations_at(problem, t, x, dx, NULL);
}

static inline double problem_scale(const void *problem, int i, double x) {
    const Problem *self = problem;
    return self->absolute * self->nominal[i] + self->relative * fabs(x);
}

/* From a time to another, the output times after the one and up to the other, which take a column
 * each (unknowns: NULL where they are not wanted), and the longest step. After the last of these
 * times follows another one, unless it is the end. */
typedef struct {
    double begin, end;
    const double *times;
    long long points;
    double *first; /* takes the unknowns at the start; NULL where they are not wanted */
    double *states, *unknowns;
    double largest;
    bool turns; /* beyond the end, the motion goes on, but inputs may move otherwise */
} Grid;

/* Where a run ended, the size of its last step, and how many output times it has passed. */
typedef struct {
    double reached, last;
    long long passed;
} Course;

/* Writes a state, and the unknowns that follow from it, as the columns of an output time. */
static inline int write_column(Problem *self, const Grid *grid, long long k, const double *x,
                               Course *course) {
    double dx[NX], *const column = grid->states + k * NX;
    if (column != x) memcpy(column, x, sizeof dx);
    ++course->passed;
    return grid->unknowns && equations_at(self, grid->times[k], x, dx, grid->unknowns + k * NZ);
}

/* The same at an event, after which the unknowns are known. */
static inline void write_event(const Problem *self, const Grid *grid, long long k, const double *x,
                               Course *course) {
    memcpy(grid->states + k * NX, x, NX * sizeof *x);
    if (grid->unknowns) memcpy(grid->unknowns + k * NZ, self->z, NZ * sizeof *self->z);
    ++course->passed;
}

#endif
