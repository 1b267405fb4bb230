/* Where a run leaves what its model is good for. */
#ifndef VALIDITY_H
#define VALIDITY_H

#include "state.h"
#include "visibility.h"

/* What a message of failure goes on with: a joint and the limit, or two empty texts. */
typedef struct {
    const char *joint, *limit;
} Hint;

INSIDE_BEGIN

/* Note on which side of a limit the instance is at a time, or of all limits by their margins. */
void note_side(Instance *self, int i, double time, bool inside);
void note_margins(Instance *self, const double margins[]);

Hint nearest_limit(const Instance *self, const double margins[]);

INSIDE_END

#endif
