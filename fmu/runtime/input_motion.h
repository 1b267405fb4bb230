/* Inputs within a communication step: polynomials of the time since that of the instance. */
#ifndef INPUT_MOTION_H
#define INPUT_MOTION_H

#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

/* Values, and first derivatives, at a time. */
void inputs_at(const Instance *self, double time, double u[]);
void input_slopes_at(const Instance *self, double time, double du[]);

/* Bring values and derivatives to a time, which becomes that of the instance. */
void move_inputs(Instance *self, double time);

/* Ask the importer for the inputs at equidistant times up to an end; they then move on the
   polynomials through them. False where it has called what it must not. */
bool ask_for_motion(Instance *self, double end);

bool inputs_rest(const Instance *self);

INSIDE_END

#endif
