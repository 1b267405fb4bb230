/* Integration from one time event to the next, and through those events of states after which time
 * events are planned anew, which the solver leaves to its caller (see watch.h).
 */
#ifndef TIMED_H
#define TIMED_H

#include "watch.h"

enum { SAME_INSTANT = 32 }; /* units in the last place of a time, as in location.py */

/* A solver: integrates x over a grid. */
typedef int Integrate(Problem *self, const Grid *grid, double *x, Course *course);

/* The output times after the first ones. */
static inline void skip_columns(Grid *self, long long count) {
    self->times += count;
    self->points -= count;
    self->states += count * NX;
    if (self->unknowns) self->unknowns += count * NZ;
}

/* The part of a grid before its next time event; one at its end is left to the caller, as inputs
 * may jump there, unless they only turn. */
static inline Grid untimed_part(const Grid *grid, const Switching *s) {
    Grid part = *grid;
    double due = next_until(s, grid->end);
    if (due > grid->end || (due == grid->end && !grid->turns)) return part;
    part.turns = false;
    part.points = 0;
    while (part.points < grid->points && grid->times[part.points] < due) ++part.points;
    if (part.points > 0 && due - grid->times[part.points - 1] <= 8 * ulp(largest_time(s, due)))
        due = grid->times[--part.points]; /* only rounding is between them */
    part.end = due;
    return part;
}

/* Goes on to the end of a part of a grid. */
static inline int integrate_part(Integrate *integrate, Problem *self, Grid part, double *x,
                                 Course *course) {
    const double near = part.begin + SAME_INSTANT * ulp(part.begin);
    double dx[NX], state[NX];
    const bool begins_near = part.end <= near || (part.points > 0 && part.times[0] <= near);
    if (!begins_near) return integrate(self, &part, x, course);
    if (equations_at(self, part.begin, x, dx, part.first) || !is_finite(dx))
        memset(dx, 0, sizeof dx);
    /* no solver begins with an output time so near, up to which the motion is a line */
    for (; part.points > 0 && part.times[0] <= near; skip_columns(&part, 1)) {
        move_along(x, dx, part.times[0] - part.begin, state);
        if (write_column(self, &part, 0, state, course)) return NOT_FINITE;
    }
    if (part.end > near) return integrate(self, &part, x, course);
    move_along(x, dx, part.end - part.begin, x);
    return SUCCESS;
}

/* Integrates x over a grid, through the time events before its end; `watch`: NULL without any. */
static inline int integrate_timed(Integrate *integrate, Problem *self, Watch *watch,
                                  const Grid *grid, double *x, Course *course) {
    Grid left = *grid;
    if (!watch) return integrate_part(integrate, self, left, x, course);
    for (;;) {
        const Grid part = untimed_part(&left, watch->switching);
        const bool is_last = part.end == left.end && part.turns == left.turns;
        const long long passed = course->passed;
        const int code = integrate_part(integrate, self, part, x, course);
        skip_columns(&left, course->passed - passed);
        if (code != EVENT && (code != SUCCESS || is_last)) return code;
        Crossing event = {course->reached, watch->relation, course->reached};
        if (code == SUCCESS) {
            double dx[NX], z[NZ + 1];
            event = (Crossing){part.end, -1, part.end};
            if (NZ > 0 && equations_at(self, part.end, x, dx, z)) return NOT_FINITE;
            if (NZ > 0) memcpy(self->z, z, NZ * sizeof *z);
        }
        course->reached = event.time;
        watch->relation = event.relation;
        if (pass_event(watch, &event, x, true)) return EVENT;
        watch->relation = -1;
        left.begin = event.time;
        left.first = NULL;
        if (left.points > 0 && left.times[0] == left.begin) {
            write_event(self, &left, 0, x, course);
            skip_columns(&left, 1);
        }
    }
}

#endif
