/* The right-hand side as CasADi generates it, called by a solver and counted.
 *
 * Generated text stands before this one: the function
 *     rhs(t, x, z, u, c) -> (dx/dt, z)
 * and the sizes NX, NZ, NU, NC of x, z (a guess of the algebraic unknowns), inputs and constants.
 */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

/* Codes 0 to 3 are those of CasADi's own integrators. */
enum { SUCCESS, TOO_MANY_STEPS, STEP_TOO_SMALL, INCONSISTENT, NOT_FINITE, HALTED };

#define MOST_STEPS 100000 /* per output interval */

typedef struct {
    const double *z, *u, *c; /* what every call is given */
    const double **arg;      /* CasADi's work space */
    double **res;
    long long *iw;
    double *w;
    long long steps, calls;
} Problem;

/* Output times, and what a solver is told besides: tolerances, or the size of its steps. */
typedef struct {
    const double *grid;
    long long points;
    double relative, absolute, largest;
} Task;

/* dx/dt; the algebraic unknowns, too, where `z` is not NULL. Returns 0 where it has a value. */
static int slope(Problem *self, double t, const double *x, double *dx, double *z) {
    self->arg[0] = &t;
    self->arg[1] = x;
    self->arg[2] = self->z;
    self->arg[3] = self->u;
    self->arg[4] = self->c;
    self->res[0] = dx;
    self->res[1] = z;
    ++self->calls;
    return rhs(self->arg, self->res, self->iw, self->w, 0);
}

static int is_finite(const double *values) {
    double sum = 0;
    for (int i = 0; i < NX; ++i) sum += 0 * values[i]; /* 0 * inf and 0 * nan are nan */
    return sum == 0;
}
