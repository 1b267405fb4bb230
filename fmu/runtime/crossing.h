/* The first event of the states within a step of a solver. */
#ifndef CROSSING_H
#define CROSSING_H

#include "modes.h"

#if HAS_EVENTS
#define RELATIONS N_MODES
#include "crossings.h"

/* What the solver knows of the motion within its step. */
typedef struct {
    void *solver;
    void (*at)(void *solver, double t, double x[], double z[], double u[]);
} Motion;

INSIDE_BEGIN

Crossing first_crossing(Instance *self, const Motion *motion, double begin, double end);

/* Correct the time of a crossing by a state at that time; false once it is known. */
bool correct_crossing(Instance *self, Crossing *crossing, Bounds *bounds, const Point *at);

INSIDE_END
#endif

#endif
