/* Results on demand: each group of equations runs once after a setter made it stale. */
#ifndef EVALUATION_H
#define EVALUATION_H

#include "integration.h"
#include "state.h"
#include "validity.h"
#include "visibility.h"

INSIDE_BEGIN

bool all_finite(const double values[], int count);

/* Pass the common arguments of the equations, t, x, z, u, p: those of a point, or the present ones.
 */
void pass_point(Instance *self, const double *t, const double *x, const double *z, const double *u);
void pass_values(Instance *self);

/* Pass a point whose algebraic unknowns are solved for from their guess; false without a solution.
 */
bool solve_point(Instance *self, const double *t, const double x[], double z[], const double u[]);

/* The margins of the limits at a time of a motion; false where they have no value. */
bool margins_on(Instance *self, const Motion *motion, double t, double margins[]);

Status refresh(Instance *self, unsigned results);
void note_limits(Instance *self);
Hint limit_hint(Instance *self);
void begin_watching(Instance *self);
Status look_back(Instance *self, Status status);
Status get_margins(Instance *self, double margins[]);

INSIDE_END

#endif
