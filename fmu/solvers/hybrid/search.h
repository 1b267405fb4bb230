/* The end of a solver's step where a relation leaves its mode first: where fresh steps cross; where
 * they do not, it was only touched.
 */
#ifndef HYBRID_SEARCH_H
#define HYBRID_SEARCH_H

#include "enclosure.h"
#include "margins.h"
#include "settle.h"

enum { MOST_TRIALS_OF_A_TIME = 60, MOST_OF_NEWTON = 8 };
enum { MOST_BEYOND = 2 }; /* steps of rounding beyond a crossing */

/* By how much rounding moves a margin; that of what slides is one of its mode, a number near 1. */
static inline double slack_of(const Switching *s, int i) {
    return s->state[i] == SLIDES ? fmin(s->slack[i], LEAVING / 2) : s->slack[i];
}

/* The margins at a point. */
static inline bool margins_at(const Laws *laws, const Switching *s, const Point *at, Place *found) {
    Seen seen;
    note_no_event(at->t, found);
    if (!look_closely(laws, s, at, &seen)) return false;
    measure(laws, s, modes_of(at), &seen, found->inside, found->rates);
    return true;
}

typedef struct {
    double time;
    int relation; /* -1: none */
    double since; /* from then on, only rounding is between the argument and its boundary */
} Crossing;

/* How a motion goes on beyond the end of a step: by events there, as it is, or as it is but for
 * what inputs move, which may turn. */
typedef enum { BY_EVENTS, AS_IS, BUT_INPUTS } Beyond;

/* The relation that leaves its mode at a place, such as an output time, whatever side rounding has
 * left it on; -1: none. */
static inline int leaving_at(const Laws *laws, const Switching *s, const Place *place,
                             Beyond beyond) {
    for (int i = 0; i < MODES && beyond != BY_EVENTS; ++i)
        if (!(beyond == BUT_INPUTS && laws->relations[i].moved) &&
            is_passing(s, place->t, i, place->inside[i], place->rates[i], 1))
            return i;
    return -1;
}

/* A time at which a margin falls below 0: after it at `low`, where it was seen `within`, no later
 * than `high`, where it has been seen to be below 0 if it `crosses`. One that rises may jump a
 * little later than was seen: `further` on. */
typedef struct {
    double low, high, end, within, further;
    int trials;
    bool crosses;
} Bounds;

/* The time to try after one with this margin and rate, by Newton's method and at last by halving;
 * the same time once it is known to rounding. */
static inline double better_time(Bounds *self, double t, double inside, double rate) {
    double better = t - inside / rate;
    const bool beyond = inside < 0, lost = !beyond && t >= self->high; /* as steps are rounded */
    if (!beyond) {
        self->low = t;
        self->within = inside;
    }
    if (beyond || lost) {
        self->high = beyond ? t : self->end;
        self->crosses = beyond;
    }
    self->further = fmax(8 * self->further, 4 * ulp(self->high));
    if (!self->crosses && rate > 0)
        better = fmin(self->low + self->further, self->high);
    else if (!(rate < 0 && better >= self->low && better <= self->high) ||
             ++self->trials > MOST_OF_NEWTON)
        better = self->low + (self->high - self->low) / 2;
    return fabs(better - t) <= 2 * DBL_EPSILON * fabs(better) ? t : better;
}

/* Whether a relation has, or may have, left its mode between two places, be it by rounding. */
static inline int is_suspect(const Laws *laws, const Switching *s, const Place *a, const Place *b,
                             Beyond beyond) {
    Place first = *a, last = *b;
    for (int i = 0; i < MODES; ++i) {
        first.inside[i] -= slack_of(s, i);
        last.inside[i] -= slack_of(s, i);
        if (last.inside[i] < 0 || may_dip(&first, &last, i, SHALLOW)) return 1;
    }
    return leaving_at(laws, s, b, beyond) >= 0;
}

/* Whether no relation leaves its mode in a whole step by bounds on its polynomials, made so
 * accurate that what they may be off proves it, too; `off`: where `stays` looks for that. */
static inline bool stays_sharply(Stays *stays, void *motion, Quintic *step, const Off **off,
                                 const Place *a, const Place *b) {
    bool proven = false;
    *off = &step->off;
    while (!proven && sharpen(step)) proven = stays(motion, a, b);
    *off = NULL;
    return proven;
}

/* -- the end of a step at a crossing ---------------------------------------------------------- */

/* Margins at the end of a fresh step from where the present one began; false where it fails. */
typedef bool FreshStep(void *motion, double t, Place *found);

/* Where fresh steps jump beyond, as their errors do, they cross if the motion goes on there. */
typedef enum { CROSSES, JUMPS_BEYOND, TOUCHES, FAILS } Located;

/* A motion whose relations do not count from a touch on until they are within their modes again. */
typedef struct {
    LookAt *look;
    Stays *stays;
    FreshStep *fresh;
    void *motion;
    double until[GUARDS];
} Past;

static inline bool is_left_out(const Past *self, double t, int i) {
    return t < self->until[i];
}

static inline void leave_out_touched(const Past *self, Place *place) {
    for (int i = 0; i < MODES; ++i) {
        if (!is_left_out(self, place->t, i)) continue;
        place->inside[i] = NO_BOUNDARY;
        place->rates[i] = 0;
    }
}

static inline void look_past(void *past, double t, Place *found) {
    const Past *self = past;
    self->look(self->motion, t, found);
    leave_out_touched(self, found);
}

static inline bool stays_past(void *past, const Place *a, const Place *b) {
    const Past *self = past;
    return self->stays(self->motion, a, b);
}

/* What rounding of the time makes of a margin at a place. */
static inline double rounding_of_time(const Place *place, int i) {
    return 8 * DBL_EPSILON * fabs(place->t) * fabs(place->rates[i]);
}

/* The relation that crosses first, near a place: the one that was found, or one that is beyond. One
 * that is outside and comes back has crossed before all that are on their way out. */
static inline int first_at(const Past *past, const Place *place, const Switching *s, int found) {
    double least = INFINITY;
    int first = found;
    for (int i = 0; i < MODES; ++i) {
        if (is_left_out(past, place->t, i)) continue;
        const double slack = slack_of(s, i), tiny = rounding_of_time(place, i);
        const double rate = place->rates[i], inside = place->inside[i] - slack;
        const bool beyond = inside < -tiny;
        if (rate >= 0 && place->inside[i] < -(slack + tiny)) return i;
        if (!(rate < 0) || !(i == found || beyond) || !(-inside / rate < least)) continue;
        least = -inside / rate;
        first = i;
    }
    return first;
}

/* Moves a crossing to the time at which fresh steps cross; where rounding leaves a choice, to the
 * far side, so that what has become true there is true by value. */
static inline Located locate(const Past *past, const Switching *s, double begin, double end,
                             Crossing *crossing) {
    Bounds bounds = {
        fmax(begin, past->until[crossing->relation]), end, end, -INFINITY, 0, 0, false};
    double left = 0, ahead = 0; /* of the margin, and what rounding has made of it so far */
    bool rises = false;         /* a margin that does so is no end of a mode */
    bool passes = false;        /* but for rounding */
    int beyond = 0;
    for (int n = 0; n < MOST_TRIALS_OF_A_TIME; ++n) {
        const double t = crossing->time;
        Place place;
        if (!past->fresh(past->motion, t, &place)) return FAILS;
        const int i = first_at(past, &place, s, crossing->relation);
        if (i != crossing->relation)
            bounds = (Bounds){fmax(begin, past->until[i]), end, end, -INFINITY, 0, 0, false};
        crossing->relation = i;
        const double speed = fabs(place.rates[i]), slack = slack_of(s, i);
        left = place.inside[i] - slack;
        rises = place.rates[i] > 0;
        passes = is_passing(s, t, i, place.inside[i], place.rates[i], 1);
        const double most = slack + rounding_of_time(&place, i);
        ahead = fmax(most, slack + located(s, t) * time_scale(s, t) * speed);
        const double longest = fmin(t - begin, SAME_TIME * fabs(t));
        crossing->since = place.rates[i] < 0 ? t - fmin(ahead / speed, longest) : t;
        crossing->time = better_time(&bounds, t, left, place.rates[i]);
        if (crossing->time != t) continue;
        if (left > ahead && bounds.crosses) { /* and does so now, as the rounding of time tells */
            crossing->time = bounds.high;
            continue;
        }
        if (!(left > 0 && left <= most) || beyond++ == MOST_BEYOND || t >= end) break;
        crossing->time = fmin(t + 2 * ulp(t), passes ? bounds.high : end);
    }
    const double slack = slack_of(s, crossing->relation), jump = bounds.within - left;
    const bool jumps = left < -JUMP * slack && jump > MOVED * slack;
    const bool goes = bounds.crosses || passes; /* what only approaches its boundary does neither */
    if (!goes || (rises && !jumps)) return TOUCHES;
    return left <= ahead ? CROSSES : JUMPS_BEYOND;
}

/* When a relation that was touched at a time is within its mode again; infinite: not by the end. */
static inline double inside_again(const Past *self, int relation, double touch, double end) {
    for (int k = 1; touch < end && k <= PLACES; ++k) {
        const double t = k < PLACES ? touch + (end - touch) * k / PLACES : end;
        Place place;
        self->look(self->motion, t, &place);
        if (place.inside[relation] >= 0) return t;
    }
    return INFINITY;
}

/* The first crossing after a place, up to a time, where fresh steps cross; relation -1: none. At
 * that time, relations leave by rounding as the motion goes on. */
static inline Located find_crossing(LookAt *look, Stays *stays, FreshStep *fresh, void *motion,
                                    const Laws *laws, const Switching *s, double begin,
                                    Place before, double end, Beyond beyond, Crossing *found) {
    Past past = {look, stays, fresh, motion, {0}};
    Place place;
    for (int i = 0; i < GUARDS; ++i) past.until[i] = -INFINITY;
    for (int touches = 0; touches < 2 * MODES; ++touches) { /* no more than two of each */
        int relation = crossing_between(look_past, stays_past, &past, before, end, &place);
        if (relation < 0) relation = leaving_at(laws, s, &place, beyond);
        if (relation < 0) break;
        *found = (Crossing){place.t, relation, place.t};
        const Located how = locate(&past, s, begin, end, found);
        if (how == CROSSES || how == FAILS) return how;
        const int i = found->relation;
        if (how == JUMPS_BEYOND) {
            Place last;
            look(motion, end, &last);
            if (last.inside[i] < 0 && last.rates[i] < 0) return CROSSES;
        }
        const bool first = past.until[i] == -INFINITY;
        past.until[i] = first ? inside_again(&past, i, place.t, end) : INFINITY;
        before = place;
        leave_out_touched(&past, &before);
    }
    *found = (Crossing){end, -1, end};
    return CROSSES;
}

#endif
