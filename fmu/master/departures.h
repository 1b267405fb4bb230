/* Events at communication points that inputs cause which leave their rest on a threshold with a
 * power of time: macro steps find the crossing where it is more than rounding, maybe much later. */
#ifndef DEPARTURES_H
#define DEPARTURES_H

#include "communication_points.h"

enum { MOST_LOOKS = 12 };

static const double FARTHEST = 8e-3; /* look ahead, of the span; each is half as far as the last */
static const double LEAST_GROWTH = 6, SAME_GROWTH = 1.4; /* of the rate, with twice the time */
static const double TINY_MOVE = 1e-11; /* of an input, of its size; another power does less */

/* How the input that moves fastest has left its rest at the end of a look. */
typedef struct {
    double rate, moved; /* `moved`: of its size */
} Departure;

/* Look by a macro step whether an input leaves its rest at the present point so that an event of
 * its part happens there; else the rate is 0. */
static inline int look(Coupling *self, double length, Departure *found) {
    System *system = self->system;
    double error;
    *found = (Departure){0, 0};
    self->next.t = self->now.t + length;
    self->looks = 1;
    const int how = macro_step(self, 1, &error);
    self->looks = 0;
    if (how == BROKEN) return CALL_FAILED;
    const int here = how == EVENT_WITHIN && same_time(system, self->event, self->now.t);
    self->event = INFINITY;
    const Part *part = system->parts + system->part;
    for (long long k = part->first_input; here && k < part->first_input + part->inputs; ++k) {
        const double rate = self->next.r[k], value = self->now.u[k];
        if (self->now.r[k] != 0 || !(fabs(rate) > fabs(found->rate))) continue;
        *found = (Departure){rate, fabs(self->next.u[k] - value) / size_of(system, k, value)};
    }
    return DONE;
}

/* Let an event happen at the present point if shorter and shorter looks agree on it, until what an
 * input moves is little more than rounding. */
static inline int pass_departures(Coupling *self) {
    System *system = self->system;
    Departure found = {0, 0};
    double length = FARTHEST * (system->stop - system->start), growth = 0;
    int rests = 0, tells = 0;
    for (long long k = 0; k < system->inputs; ++k) rests |= !system->held[k] && self->now.r[k] == 0;
    self->looked = 1;
    if (!rests || system->quantum > 0) return DONE;
    length = fmin(length, system->goal - self->now.t);
    if (save_all(self)) return CALL_FAILED;
    for (int n = 0; n < MOST_LOOKS && !tells; ++n, length /= 2) {
        const double before = growth, last = found.rate;
        if (n && restore_all_but(self, NULL)) return CALL_FAILED;
        if (look(self, length, &found) != DONE) return CALL_FAILED;
        if (found.rate == 0) break;
        growth = last / found.rate;
        tells = found.moved <= TINY_MOVE && before >= LEAST_GROWTH && growth >= LEAST_GROWTH &&
                growth <= SAME_GROWTH * before && before <= SAME_GROWTH * growth;
    }
    if (!tells) return restore_all_but(self, NULL) ? CALL_FAILED : DONE;
    self->powers = 1;
    self->event = self->now.t;
    return back_to_event(self);
}

#endif
