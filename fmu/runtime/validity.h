/* Where a run leaves what its model is good for. */
#ifndef VALIDITY_H
#define VALIDITY_H

#include "state.h"

/* What a message of failure goes on with: a joint and the limit, or two empty texts. */
typedef struct {
    const char *joint, *limit;
} Hint;

/* Note on which side of a limit the instance is at a time, or of all limits by their margins. */
static void note_side(Instance *self, int i, double time, bool inside);
static void note_margins(Instance *self, const double margins[]);

static Hint nearest_limit(const Instance *self, const double margins[]);

#endif
