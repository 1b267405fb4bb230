/* The constants of an instance: its parameters, and what depends on parameters alone. */
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

#endif
