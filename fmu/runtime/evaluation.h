/* Results on demand: each group of equations runs once after a setter made it stale. */
#ifndef EVALUATION_H
#define EVALUATION_H

#include "integration.h"
#include "state.h"
#include "validity.h"

static bool all_finite(const double values[], int count);

/* Pass the common arguments of the equations, t, x, z, u, p: those of a point, or the present ones.
 */
static void pass_point(Instance *self, const double *t, const double *x, const double *z,
                       const double *u);
static void pass_values(Instance *self);

/* Pass a point whose algebraic unknowns are solved for from their guess; false without a solution.
 */
static bool solve_point(Instance *self, const double *t, const double x[], double z[],
                        const double u[]);

/* The margins of the limits at a time of a motion; false where they have no value. */
static bool margins_on(Instance *self, const Motion *motion, double t, double margins[]);

static Status refresh(Instance *self, unsigned results);
static void note_limits(Instance *self);
static Hint limit_hint(Instance *self);
static void begin_watching(Instance *self);
static Status look_back(Instance *self, Status status);
static Status get_margins(Instance *self, double margins[]);

#endif
