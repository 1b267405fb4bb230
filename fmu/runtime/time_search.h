/* When relations of time alone that are not linear in time switch next, if there are bounds of
   their arguments. */
#ifndef TIME_SEARCH_H
#define TIME_SEARCH_H

#include "modes.h"

#if N_BOUNDED > 0
INSIDE_BEGIN

/* The first time after `now` and up to `end` at which such relations switch; `NO_EVENT` if there is
   none. `due` of those that do becomes that time, or `JUMPS` where the argument does. */
double search_bounded(Instance *self, double now, double end, double due[]);

INSIDE_END
#endif

#endif
