/* Results on demand: each group of equations runs once after a setter made it stale. */
#ifndef EVALUATION_H
#define EVALUATION_H

#include "state.h"
#include "validity.h"
#include "visibility.h"

INSIDE_BEGIN

bool all_finite(const double values[], int count);
void pass_values(Instance *self);
Status refresh(Instance *self, unsigned results);
void note_limits(Instance *self);
Hint limit_hint(Instance *self);
void begin_watching(Instance *self);
Status look_back(Instance *self, Status status);
Status get_margins(Instance *self, double margins[]);

INSIDE_END

#endif
