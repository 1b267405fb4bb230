/* Inputs within a communication step: polynomials of the time since that of the instance. */
#ifndef INPUT_MOTION_H
#define INPUT_MOTION_H

#include "state.h"

/* Values, and first derivatives, at a time. */
static void inputs_at(const Instance *self, double time, double u[]);
static void input_slopes_at(const void *instance, double time, double du[]);

/* Bring values and derivatives to a time, which becomes that of the instance. */
static void move_inputs(Instance *self, double time);

/* Ask the importer for the inputs at equidistant times up to an end; they then move on the
   polynomials through them. False where it has called what it must not. */
static bool ask_for_motion(Instance *self, double end);

static bool inputs_rest(const Instance *self);

#endif
