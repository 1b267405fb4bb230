/* The solver of co-simulation; one of the files integration_*.c is compiled. */
#ifndef INTEGRATION_H
#define INTEGRATION_H

#include "state.h"

typedef struct Quintic Quintic;

/* What the solver knows of the motion within its step: `box`, between which values the states stay,
   or NULL; and fresh steps from where that began: these return false where they fail. Where steps
   have a fixed size, also the slopes of their stages and what makes `at` more accurate. */
typedef struct {
    void *solver;
    void (*at)(void *solver, double t, double x[], double z[], double u[]);
    void (*box)(void *solver, double low[], double high[]);
    bool (*step_to)(void *solver, double t, double x[], double z[], double u[]);
    const double *stages;
    Quintic *quintic;
} Motion;

/* Integrate up to `end`, or as far as it goes; time tells. Inputs move with their slopes. True
   where it went as far as was wanted: `Host.step_finished` may bring the end forward. */
static bool integrate_to(Instance *self, double end);

/* Let the solver start afresh: an event has changed what it was going on from. */
static void restart_solver(Instance *self);

/* A step that is short enough for the motion at the present state. */
static double typical_step(Instance *self);

#endif
