/* Between communication points: what a solver's step that ends there means to others. */
#include "midway.h"

#include "evaluation.h"

/* Warn of limits, and let the importer look and perhaps bring the end forward. False where it has
   called what it must not. */
bool pass_midway(Instance *self, double *end) {
    note_limits(self);
    return !self->host.step_finished || self->host.step_finished(self, end);
}
