/* Singular configurations, where the constraints of a model lose rank and branches of motion meet:
   only the previous motion determines the branch. Without HAS_RANK there is no detection. */
#ifndef RANK_H
#define RANK_H

#include "state.h"

#if HAS_RANK
/* Distance of the constraints from a singular configuration where the arguments of the equations
   are already passed, 1 at best; 0 where it has no number. Its rate is wanted where `rate` is not
   NULL. */
static double rank_at(Instance *self, double *rate);

/* Move the states of a time to where the constraints hold; false where that cannot be done. */
static bool keep_constraints(Instance *self, double t, const double u[], double x[]);

/* Begin to watch; note an evaluation; look back over a step that is completed, and return `status`
   where there was a singular configuration on the way. Derivatives must be fresh. */
static void begin_watch(Instance *self);
static void note_rank(Instance *self);
static Status watch_rank(Instance *self, Status status);
#else
#define begin_watch(self) ((void)(self))
#define note_rank(self) ((void)(self))
#define watch_rank(self, status) ((void)(self), (void)(status), OK)
#endif

#endif
