/* The time from `now` on is searched in spans that grow and shrink, like steps. By the bounds of
   its argument and of the two derivatives of that, a relation cannot leave its mode within a span,
   or does so exactly once; otherwise the span is halved. */
#include "time_search.h"

#if N_BOUNDED > 0

#include <math.h>

#include "equations.h"
#include "evaluation.h"

enum {
    LEAST = 4,      /* units in the last place of the end: the length of the shortest span */
    NOISE = 16,     /* those of the present time within which an event has just been */
    SAMPLES = 4096, /* in the time that is searched, where arguments have no value */
    ORDERS = 3      /* value, first and second derivative */
};

static const double UNKNOWN = -DBL_MAX;

/* What is positive within a mode: sign (argument - boundary). */
typedef struct {
    int row; /* of `bounded` */
    double sign, boundary;
} Guard;

enum { MOST_GUARDS = 2 * N_BOUNDED };

typedef struct {
    double t, values[MOST_GUARDS], rates[MOST_GUARDS];
} Sight;

/* A guard and its rate at a time. */
typedef struct {
    double t, value, rate;
} Side;

static double ulp(double t) {
    return nextafter(fabs(t), INFINITY) - fabs(t);
}

static int set_guards(const Instance *self, Guard guards[]) {
    int n = 0;
    for (int row = 0; row < N_BOUNDED; row++) {
        const double mode = self->state.values[FIRST_MODE + bounded[row]];
        if (relations[bounded[row]].floor) {
            guards[n++] = (Guard){row, 1, mode};
            guards[n++] = (Guard){row, -1, mode + 1};
        } else {
            guards[n++] = (Guard){row, mode, 0};
        }
    }
    return n;
}

static void look(Instance *self, int n, const Guard guards[], double t, Sight *seen) {
    double arguments[N_MODES], rates[N_MODES];
    evaluate_timed(self, t, arguments, rates);
    seen->t = t;
    for (int k = 0; k < n; k++) {
        const int i = bounded[guards[k].row];
        seen->values[k] = guards[k].sign * (arguments[i] - guards[k].boundary);
        seen->rates[k] = guards[k].sign * rates[i];
    }
}

static Side side_at(Instance *self, const Guard *guard, double t) {
    Sight seen;
    look(self, 1, guard, t, &seen);
    return (Side){t, seen.values[0], seen.rates[0]};
}

/* A time at which a convex guard is negative between two; `NO_EVENT` if none is. */
static double dip(Instance *self, const Guard *guard, Side a, Side b) {
    for (bool halve = false;; halve = !halve) {
        const double length = b.t - a.t, bend = b.rate - a.rate;
        const double lowest = a.value + a.rate * (a.value - b.value + b.rate * length) / bend;
        const double middle = a.t + length / 2;
        double t = halve ? middle : a.t - length * a.rate / bend;
        if (!(t > a.t && t < b.t)) t = middle;
        if (lowest > 0 || !(t > a.t && t < b.t)) return NO_EVENT;
        const Side seen = side_at(self, guard, t);
        if (seen.value < 0) return t;
        if (seen.rate < 0)
            a = seen;
        else
            b = seen;
    }
}

/* A time until which a guard becomes negative just once after `a`, where it is not; `NO_EVENT` if
   it does not before `b`, `UNKNOWN` if the bounds between them do not tell. */
static double leaves(Instance *self, const Guard *guard, Side a, Side b, const double lows[],
                     const double highs[]) {
    double low[ORDERS], high[ORDERS];
    for (int order = 0; order < ORDERS; order++) {
        const int i = ORDERS * guard->row + order;
        low[order] = guard->sign * (guard->sign > 0 ? lows[i] : highs[i]);
        high[order] = guard->sign * (guard->sign > 0 ? highs[i] : lows[i]);
    }
    const double length = b.t - a.t;
    if (low[0] - guard->sign * guard->boundary >= 0) return NO_EVENT;
    if (!isfinite(high[0] - low[0]) || !isfinite(high[1] - low[1])) return UNKNOWN;
    if (low[1] >= 0) return b.value >= 0 ? NO_EVENT : UNKNOWN;
    const bool curved = isfinite(high[2] - low[2]);
    if (high[1] <= 0 || (curved && high[2] <= 0)) return b.value < 0 ? b.t : NO_EVENT;
    const double reach = low[1] * high[1] * length;
    if (b.value >= 0 && high[1] * a.value - low[1] * b.value + reach > 0) return NO_EVENT;
    if (curved && fmin(a.value, b.value) > high[2] * length * length / 8) return NO_EVENT;
    if (!curved || !(low[2] >= 0)) return UNKNOWN;
    if (b.value < 0) return a.rate < 0 ? b.t : UNKNOWN;
    return a.rate >= 0 || b.rate <= 0 ? NO_EVENT : dip(self, guard, a, b);
}

/* The first time at which a guard is negative that becomes so once. */
static double root(Instance *self, const Guard *guard, double low, double high) {
    for (double t = low + (high - low) / 2; t > low && t < high; t = low + (high - low) / 2) {
        const double value = side_at(self, guard, t).value;
        if (value < 0 && isfinite(value))
            high = t;
        else
            low = t;
    }
    return high;
}

double search_bounded(Instance *self, double now, double end, double due[]) {
    Guard guards[MOST_GUARDS];
    Sight a, b;
    const int n = set_guards(self, guards);
    if (!(now < end)) return NO_EVENT;
    look(self, n, guards, now, &a);
    look(self, n, guards, now + NOISE * ulp(now), &b);
    for (int k = 0; k < n; k++) {
        if (a.values[k] >= 0 || b.values[k] >= 0) continue;
        due[bounded[guards[k].row]] = JUMPS;
        return nextafter(now, INFINITY);
    }
    const double shortest = LEAST * ulp(fmax(fabs(now), fabs(end)));
    double least = shortest, length = end - now;
    while (a.t < end) {
        double lows[ORDERS * N_BOUNDED], highs[ORDERS * N_BOUNDED], times[MOST_GUARDS];
        bool unknown = false;
        for (int k = 0; k < n; k++)
            if (a.values[k] < 0) a.values[k] = 0; /* but for rounding */
        look(self, n, guards, fmin(a.t + length, end), &b);
        const double span = b.t - a.t;
        pass_values(self);
        self->arg[0] = &a.t;
        self->arg[5] = &span;
        self->res[0] = lows;
        self->res[1] = highs;
        if (model_bounds(self->arg, self->res, self->iw, self->w, 0)) return NO_EVENT;
        for (int k = 0; k < n; k++) {
            const Side from = {a.t, a.values[k], a.rates[k]}, to = {b.t, b.values[k], b.rates[k]};
            times[k] = leaves(self, &guards[k], from, to, lows, highs);
            unknown |= times[k] == UNKNOWN;
        }
        if (unknown && length > least) {
            length = fmax(length / 2, least);
            continue;
        }
        double first = NO_EVENT;
        bool known[MOST_GUARDS];
        for (int k = 0; k < n; k++) {
            known[k] = times[k] != UNKNOWN;
            if (!known[k]) times[k] = b.values[k] < 0 ? b.t : NO_EVENT;
            if (times[k] != NO_EVENT) times[k] = root(self, &guards[k], a.t, times[k]);
            first = fmin(first, times[k]);
        }
        if (first != NO_EVENT) {
            const double near = 8 * ulp(first);
            look(self, n, guards, first + near, &b); /* others that switch at the same time */
            for (int k = 0; k < n; k++) {
                const bool same = b.values[k] < 0 && b.values[k] >= 4 * near * b.rates[k];
                double *own = &due[bounded[guards[k].row]];
                if ((known[k] && times[k] <= first + near) || same)
                    *own = first;
                else if (times[k] <= first + near && *own == NO_EVENT)
                    *own = JUMPS;
            }
            return first;
        }
        if (unknown) { /* it only touches its boundary, or has no value */
            least = fmax(shortest, fmin(2 * least, (end - now) / SAMPLES));
            length = least;
        } else {
            if (length > 8 * least) least = shortest;
            length *= 2;
        }
        a = b;
    }
    return NO_EVENT;
}

#else
typedef int no_time_search; /* C knows no empty file */
#endif
