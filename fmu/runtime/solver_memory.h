/* What the solver of co-simulation goes on from; part of the FMU state, all of it doubles. */
#ifndef SOLVER_MEMORY_H
#define SOLVER_MEMORY_H

#include "variables.h"

#if SOLVER_DOP853
#include "interpolant.h"

typedef struct {
    Interpolant piece; /* where the last step ended beyond a communication point */
    double until;      /* end of the last step */
    double end[NX], slope[NX];
    double next;                   /* size of the step that follows; 0: there was none before */
    double rested;                 /* 1: the inputs did not move during the last step */
    double inputs[ROOM(NU)];       /* as it began */
    double leaves[ROOM(N_LIMITS)]; /* when it leaves each limit first; DBL_MAX: never */
#if HAS_EVENTS
    double crossing; /* relation that leaves its mode where the last step ended, from 1 on; or 0 */
    double since;    /* from then on, only rounding is between it and its boundary */
#endif
} SolverMemory;
#else
typedef struct {
    double none; /* it starts anew in every communication step */
} SolverMemory;
#endif

#endif
