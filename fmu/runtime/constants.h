/* The constants of an instance: its parameters, and what depends on parameters alone;
   and how the equations get them. */
#ifndef CONSTANTS_H
#define CONSTANTS_H

#include <math.h>
#include <string.h>

#include "equations.h"
#include "state.h"

/* Whoever changes parameters has to call it; without effect where they are the same. */
static void renew_constants(Instance *self) {
    const double *p = self->state.values + FIRST_PARAMETER;
    if (memcmp(self->constants, p, NP * sizeof *p) == 0) return;
    self->arg[0] = p;
    self->res[0] = self->constants;
    if (!model_constants(self->arg, self->res, self->iw, self->w, 0)) return;
    for (int i = 0; i < NC; i++) self->constants[i] = NAN; /* so that no result has a value */
}

/* Pass the common arguments of the equations, t, x, z, u, c: those of a point, or the present ones.
 */
static void pass_point(Instance *self, const double *t, const double *x, const double *z,
                       const double *u) {
    self->arg[0] = t;
    self->arg[1] = x;
    self->arg[2] = z;
    self->arg[3] = u;
    self->arg[4] = self->constants;
}

static void pass_values(Instance *self) {
    const double *values = self->state.values;
    pass_point(self, values + TIME, values + FIRST_STATE, values + FIRST_ALGEBRAIC,
               values + FIRST_INPUT);
}

#endif
