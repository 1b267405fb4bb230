/* When relations of time alone switch next: exactly, where they are linear in time; otherwise the
 * time from now on is searched in spans that grow and shrink, like steps. By the bounds of its
 * argument and of the two derivatives of that, a relation cannot leave its mode within a span, or
 * does so exactly once; otherwise the span is halved. Arguments without bounds are sampled.
 */
#ifndef HYBRID_PLAN_H
#define HYBRID_PLAN_H

#include "enclosure.h"

enum {
    SEARCHED = 4096, /* samples of an argument without bounds, or where bounds have no value */
    LEAST = 4,       /* units in the last place of the end: the length of the shortest span */
    NOISE = 16,      /* those of the present time within which an event has just been */
    ORDERS = 3       /* bounds of value, first and second derivative */
};

/* Where an argument `value + rate t` leaves its mode. */
static inline double linear_root(double mode, bool floor, double value, double rate, double now) {
    if (rate == 0 || (!floor && mode * rate > 0)) return NEVER_AGAIN;
    const double boundary = !floor ? 0 : rate > 0 ? mode + 1 : mode;
    const double t = (boundary - value) / rate;
    return isfinite(t) ? fmax(t, nextafter(now, INFINITY)) : NEVER_AGAIN;
}

static inline bool is_outside(const Laws *laws, const Point *at, int i, double t) {
    return is_beyond(laws->relations[i].floor, modes_of(at)[i], timed_argument(laws, at, i, t));
}

static inline double searched_root(const Laws *laws, const Point *at, int i, double now,
                                   double end) {
    double low = now, high = NEVER_AGAIN;
    for (int k = 1; k <= SEARCHED && high == NEVER_AGAIN; k++) {
        const double t = now + (end - now) * k / SEARCHED;
        *(is_outside(laws, at, i, t) ? &high : &low) = t;
    }
    if (high == NEVER_AGAIN) return NEVER_AGAIN;
    for (double t = low + (high - low) / 2; t > low && t < high; t = low + (high - low) / 2)
        *(is_outside(laws, at, i, t) ? &high : &low) = t;
    return high;
}

static inline bool is_bounded(const Laws *laws, int i) {
    for (int k = 0; k < BOUNDED; k++)
        if (laws->bounded[k] == i) return true;
    return false;
}

/* -- by bounds -------------------------------------------------------------------------------- */

#if BOUNDED > 0

static const double UNKNOWN = -DBL_MAX;

/* What is positive within a mode: sign (argument - boundary). */
typedef struct {
    int row; /* of `bounded` */
    double sign, boundary;
} Guard;

enum { MOST_GUARDS = 2 * BOUNDED };

typedef struct {
    double t, values[MOST_GUARDS], rates[MOST_GUARDS];
} Sight;

/* A guard and its rate at a time. */
typedef struct {
    double t, value, rate;
} Side;

typedef struct {
    const Laws *laws;
    const Point *at;
    int count;
    Guard guards[MOST_GUARDS];
} Guards;

static inline void set_guards(Guards *self) {
    self->count = 0;
    for (int row = 0; row < BOUNDED; row++) {
        const int relation = self->laws->bounded[row];
        const double mode = modes_of(self->at)[relation];
        if (self->laws->relations[relation].floor) {
            self->guards[self->count++] = (Guard){row, 1, mode};
            self->guards[self->count++] = (Guard){row, -1, mode + 1};
        } else {
            self->guards[self->count++] = (Guard){row, mode, 0};
        }
    }
}

static inline void see_guards(const Guards *self, int first, int count, double t, Sight *seen) {
    double arguments[MODES + 1], rates[MODES + 1];
    const bool valued = self->laws->timed(self->laws->owner, self->at, t, arguments, rates);
    seen->t = t;
    for (int k = 0; k < count; k++) {
        const Guard *guard = &self->guards[first + k];
        const int i = self->laws->bounded[guard->row];
        seen->values[k] = valued ? guard->sign * (arguments[i] - guard->boundary) : NAN;
        seen->rates[k] = valued ? guard->sign * rates[i] : NAN;
    }
}

static inline Side side_at(const Guards *self, int k, double t) {
    Sight seen;
    see_guards(self, k, 1, t, &seen);
    return (Side){t, seen.values[0], seen.rates[0]};
}

/* A time at which a convex guard is negative between two; `NEVER_AGAIN` if none is. */
static inline double dip(const Guards *self, int k, Side a, Side b) {
    for (bool halve = false;; halve = !halve) {
        const double length = b.t - a.t, bend = b.rate - a.rate;
        const double lowest = a.value + a.rate * (a.value - b.value + b.rate * length) / bend;
        const double middle = a.t + length / 2;
        double t = halve ? middle : a.t - length * a.rate / bend;
        if (!(t > a.t && t < b.t)) t = middle;
        if (lowest > 0 || !(t > a.t && t < b.t)) return NEVER_AGAIN;
        const Side seen = side_at(self, k, t);
        if (seen.value < 0) return t;
        *(seen.rate < 0 ? &a : &b) = seen;
    }
}

/* A time until which a guard becomes negative just once after `a`, where it is not; `NEVER_AGAIN`
 * if it does not before `b`, `UNKNOWN` if the bounds between them do not tell. */
static inline double leaves(const Guards *self, int k, Side a, Side b, const double lows[],
                            const double highs[]) {
    const Guard *guard = &self->guards[k];
    double low[ORDERS] = {0}, high[ORDERS] = {0};
    for (int order = 0; order < ORDERS; order++) {
        const int i = ORDERS * guard->row + order;
        low[order] = guard->sign * (guard->sign > 0 ? lows[i] : highs[i]);
        high[order] = guard->sign * (guard->sign > 0 ? highs[i] : lows[i]);
    }
    const double length = b.t - a.t;
    const Spanned span = {low[0] - guard->sign * guard->boundary, low[1], high[1]};
    if (span.low >= 0) return NEVER_AGAIN;
    if (b.value >= 0 && stays_positive(&span, a.value, b.value, length)) return NEVER_AGAIN;
    if (!isfinite(high[0] - low[0]) || !isfinite(high[1] - low[1]) || low[1] >= 0) return UNKNOWN;
    const bool curved = isfinite(high[2] - low[2]);
    if (high[1] <= 0 || (curved && high[2] <= 0)) return b.value < 0 ? b.t : NEVER_AGAIN;
    if (curved && fmin(a.value, b.value) > high[2] * length * length / 8) return NEVER_AGAIN;
    if (!curved || !(low[2] >= 0)) return UNKNOWN;
    if (b.value < 0) return a.rate < 0 ? b.t : UNKNOWN;
    return a.rate >= 0 || b.rate <= 0 ? NEVER_AGAIN : dip(self, k, a, b);
}

/* The first time at which a guard is negative that becomes so once. */
static inline double root(const Guards *self, int k, double low, double high) {
    for (double t = low + (high - low) / 2; t > low && t < high; t = low + (high - low) / 2) {
        const double value = side_at(self, k, t).value;
        *(value < 0 && isfinite(value) ? &high : &low) = t;
    }
    return high;
}

/* Notes which relations switch at a time, by what was found of each guard up to it. */
static inline void note_due(const Guards *self, double first, const double times[],
                            const bool known[], double due[]) {
    const double near = 8 * ulp(first);
    Sight after; /* others that switch at the same time */
    see_guards(self, 0, self->count, first + near, &after);
    for (int k = 0; k < self->count; k++) {
        const bool same = after.values[k] < 0 && after.values[k] >= 4 * near * after.rates[k];
        double *own = &due[self->laws->bounded[self->guards[k].row]];
        if ((known[k] && times[k] <= first + near) || same)
            *own = first;
        else if (times[k] <= first + near && *own == NEVER_AGAIN)
            *own = JUMPS;
    }
}

/* The first time after `now` and up to `end` at which such relations switch; `NEVER_AGAIN` if there
 * is none. `due` of those that do becomes that time, or `JUMPS` where the argument does. */
static inline double search_bounded(const Laws *laws, const Point *at, double now, double end,
                                    double due[]) {
    Guards every = {.laws = laws, .at = at};
    Sight a, b;
    set_guards(&every);
    const int n = every.count;
    if (!(now < end)) return NEVER_AGAIN;
    see_guards(&every, 0, n, now, &a);
    see_guards(&every, 0, n, now + NOISE * ulp(now), &b);
    for (int k = 0; k < n; k++) {
        if (a.values[k] >= 0 || b.values[k] >= 0) continue;
        due[laws->bounded[every.guards[k].row]] = JUMPS;
        return nextafter(now, INFINITY);
    }
    const double shortest = LEAST * ulp(fmax(fabs(now), fabs(end)));
    double least = shortest, length = end - now;
    while (a.t < end) {
        double lows[ORDERS * BOUNDED], highs[ORDERS * BOUNDED], times[MOST_GUARDS];
        bool unknown = false;
        for (int k = 0; k < n; k++)
            if (a.values[k] < 0) a.values[k] = 0; /* but for rounding */
        see_guards(&every, 0, n, fmin(a.t + length, end), &b);
        if (!laws->bounds(laws->owner, at, a.t, b.t - a.t, lows, highs)) return NEVER_AGAIN;
        for (int k = 0; k < n; k++) {
            const Side from = {a.t, a.values[k], a.rates[k]}, to = {b.t, b.values[k], b.rates[k]};
            times[k] = leaves(&every, k, from, to, lows, highs);
            unknown |= times[k] == UNKNOWN;
        }
        if (unknown && length > least) {
            length = fmax(length / 2, least);
            continue;
        }
        double first = NEVER_AGAIN;
        bool known[MOST_GUARDS];
        for (int k = 0; k < n; k++) {
            known[k] = times[k] != UNKNOWN;
            if (!known[k]) times[k] = b.values[k] < 0 ? b.t : NEVER_AGAIN;
            if (times[k] != NEVER_AGAIN) times[k] = root(&every, k, a.t, times[k]);
            first = fmin(first, times[k]);
        }
        if (first != NEVER_AGAIN) {
            note_due(&every, first, times, known, due);
            return first;
        }
        if (unknown) { /* it only touches its boundary, or has no value */
            least = fmax(shortest, fmin(2 * least, (end - now) / SEARCHED));
            length = least;
        } else {
            if (length > 8 * least) least = shortest;
            length *= 2;
        }
        a = b;
    }
    return NEVER_AGAIN;
}

#endif

/* -- the plan --------------------------------------------------------------------------------- */

/* Sets `due` and `next` for times after `now`. What is not linear is searched up to `end`, and then
 * anew unless the run ends there; a known time at which a step has to end may come first. */
static inline void plan(const Laws *laws, Switching *s, const Point *at, double now, double end,
                        bool ends, double known) {
    double values[MODES + 1], rates[MODES + 1];
    const bool valued = laws->timed(laws->owner, at, 0, values, rates);
    s->next = known;
    for (int i = 0; i < MODES; i++) {
        const Relation *relation = &laws->relations[i];
        s->due[i] = NEVER_AGAIN;
        if (!relation->of_time || is_bounded(laws, i)) continue;
        if (relation->linear && valued)
            s->due[i] = linear_root(modes_of(at)[i], relation->floor, values[i], rates[i], now);
        if (!relation->linear) s->due[i] = searched_root(laws, at, i, now, end);
        const bool further = !relation->linear && s->due[i] == NEVER_AGAIN && !ends;
        s->next = fmin(s->next, further ? end : s->due[i]);
        if (!relation->linear && s->due[i] != NEVER_AGAIN) s->due[i] = JUMPS;
    }
#if BOUNDED > 0
    const double until = fmin(s->next, end) + 8 * ulp(fmin(s->next, end));
    const double first = search_bounded(laws, at, now, until, s->due);
    s->next = fmin(s->next, first == NEVER_AGAIN && !ends ? end : first);
#endif
}

#endif
