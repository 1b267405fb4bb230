/* The first event of the states within a step of a solver. */
#include "crossing.h"

#include <math.h>

#if HAS_EVENTS

typedef struct {
    Instance *fmu;
    const Motion *motion;
} SearchedStep;

static void look_at(void *step, double t, Place *found) {
    const SearchedStep *self = step;
    double x[ROOM(NX)], z[ROOM(NZ)] = {0}, u[ROOM(NU)];
    found->t = t;
    self->motion->at(self->motion->solver, t, x, z, u);
    const Point at = {t, x, z, u};
    if (inside_at(self->fmu, &at, found->inside, found->rates)) return;
    for (int i = 0; i < N_MODES; i++) {
        found->inside[i] = 1;
        found->rates[i] = 0;
    }
}

Crossing first_crossing(Instance *self, const Motion *motion, double begin, double end) {
    SearchedStep step = {self, motion};
    Place before;
    look_at(&step, begin, &before);
    return crossing_between(look_at, &step, before, end);
}

bool correct_crossing(Instance *self, Crossing *crossing, Bounds *bounds, const Point *at) {
    double inside[ROOM(N_MODES)], rates[ROOM(N_MODES)];
    const int i = crossing->relation;
    if (!inside_at(self, at, inside, rates)) return false;
    crossing->time =
        better_time(bounds, at->t, inside[i] - self->state.switching.slack[i], rates[i]);
    return crossing->time != at->t;
}

#else
typedef int no_crossings; /* C knows no empty file */
#endif
