/* Where a run leaves what its model is good for. */
#ifndef VALIDITY_H
#define VALIDITY_H

#include <math.h>

#include "logging.h"

/* What a message of failure goes on with: a joint and the limit, or two empty texts. */
typedef struct {
    const char *joint, *limit;
} Hint;

/* Warn of a limit that is left, and again after a whole communication step inside, so that a motion
   that chatters causes one warning; the run goes on. In model exchange a limit that has been left
   is not watched any more, as margins beyond it may have poles; `valid` needs both directions. */
static void note_side(Instance *self, int i, double time, bool inside) {
    State *state = &self->state;
    double *was_outside = &state->outside[i];
    const double step = state->steps + 1, last = state->left[i];
    if (inside && !HAS_VALID && state->interface == INTERFACE_ME) return;
    if (!inside && *was_outside == 0 && (last == 0 || step > last + 1))
        log_text(self, WARNING, "invalid from %.12g s: %s", time, violations[i]);
    if (!inside) state->left[i] = step;
    state->violated += (uint32_t)!inside - (uint32_t)*was_outside;
    *was_outside = !inside;
}

/* What is not a number is outside. */
static void note_margins(Instance *self, const double margins[]) {
    State *state = &self->state;
    for (int i = 0; i < N_LIMITS; i++) {
        note_side(self, i, state->values[TIME], margins[i] > 0);
        if (isfinite(margins[i])) state->widest[i] = fmax(state->widest[i], margins[i]);
    }
}

/* The limit that a failure is likely to have to do with: one that is left, or the one whose margin
   has shrunk most. Margins have units of their own; each is measured by its widest so far. */
static Hint nearest_limit(const Instance *self, const double margins[]) {
    int nearest = -1;
    double least = INFINITY;
    for (int i = 0; i < N_LIMITS; i++) {
        const double widest = self->state.widest[i];
        const double share = widest > 0 ? margins[i] / widest : margins[i];
        if (!(share < least)) continue; /* nor where it is not a number */
        least = share;
        nearest = i;
    }
    if (nearest < 0) {
        for (int i = 0; i < N_LIMITS; i++)
            if (self->state.outside[i] > 0) return (Hint){"; invalid before: ", violations[i]};
        return (Hint){"", ""};
    }
    return least > 0 ? (Hint){"; the nearest limit: ", limits[nearest]}
                     : (Hint){"; invalid: ", violations[nearest]};
}

#endif
