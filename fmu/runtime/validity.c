/* Where a run leaves what its model is good for. */
#include "validity.h"

#include "logging.h"

_Static_assert(N_LIMITS <= 32, "a bit for each limit");

/* Warn once for each crossing of a limit; the run goes on. What is not a number is outside. */
void note_margins(Instance *self, const double margins[]) {
    for (int i = 0; i < N_LIMITS; i++) {
        const uint32_t bit = UINT32_C(1) << i;
        const bool inside = margins[i] > 0;
        if (!inside && !(self->state.outside & bit))
            log_text(self, WARNING, "from time %.9g on it is no longer true that %s",
                     self->state.values[TIME], limits[i]);
        self->state.outside = inside ? self->state.outside & ~bit : self->state.outside | bit;
    }
}

/* What is no longer true, the first of it; NULL where the model holds. */
const char *limit_left(const Instance *self) {
    for (int i = 0; i < N_LIMITS; i++)
        if (self->state.outside >> i & 1) return limits[i];
    return NULL;
}
