/* Arguments that leave a boundary more slowly than with the second power of time, found by looks at
 * the solution a little ahead, where their second derivatives grow with a power of time.
 */
#ifndef HYBRID_DEPARTURE_H
#define HYBRID_DEPARTURE_H

#include "sliding.h"

static const double FARTHEST = 1e-1; /* look, relative to the run; to 1 s, or a shorter run, ... */
static const double NEAREST = 1e-9;  /* ... and the first one, but for the rounding of time, ... */
static const double NEAR_ENOUGH = 1e-3; /* ... which leaves it so near beside the farthest one */
enum { FURTHER = 4 };                   /* how many times as far the next one is */
/* Growth from a look to the next, between those of the first and the fourth power of time, which
 * the method follows; the growth of rounding in an unstable motion does not stay the same. That of
 * a look too far for a fast motion becomes the fourth power. */
static const double LEAST_GROWTH = 3, MOST_GROWTH = 512, MOST_GROWTH_FAR = 96, SAME_GROWTH = 1.4;

/* A point with values of its own. */
typedef struct {
    double x[NX + 1], z[NZ + 1], u[NU + 1];
    Point at;
} Ahead;

/* Moves a point on by a time along rates. */
static inline void go_along(const Point *from, const Seen *rates, double h, Ahead *to) {
    for (int i = 0; i < NX; i++) to->x[i] = from->x[i] + h * rates->slopes[i];
    for (int i = 0; i < NU; i++) to->u[i] = from->u[i] + h * rates->moves[i];
    for (int i = 0; i < NZ; i++) to->z[i] = from->z[i];
    to->at = (Point){from->t + h, to->x, to->z, to->u};
}

/* Relations a time after a point, by the classical method of Runge and Kutta. */
static inline bool look_after(const Laws *laws, const Switching *s, const Point *from,
                              const Seen *first, double h, Seen *found) {
    static const double parts[] = {0.5, 0.5, 1}, weights[] = {2, 2, 1};
    Ahead to;
    Seen stage = *first, mean = *first;
    for (int k = 0; k < 3; k++) {
        go_along(from, &stage, parts[k] * h, &to);
        if (!look_closely(laws, s, &to.at, &stage)) return false;
        for (int i = 0; i < NX; i++) mean.slopes[i] += weights[k] * stage.slopes[i];
        for (int i = 0; i < NU; i++) mean.moves[i] += weights[k] * stage.moves[i];
    }
    go_along(from, &mean, h / 6, &to);
    to.at.t = from->t + h;
    return look_along(laws, s, &to.at, found);
}

/* Whether a second derivative grows as that of an argument that leaves its boundary. */
static inline bool grows_steadily(double a, double b, double c, double tiny, double most) {
    const double first = b / a, second = c / b;
    return fabs(a) > tiny && first >= LEAST_GROWTH && first <= most && second >= LEAST_GROWTH &&
           second <= most && second <= SAME_GROWTH * first && first <= SAME_GROWTH * second;
}

/* What rounding makes of time derivatives of an argument. */
static inline double rounding_of_rate(const Switching *s, const Seen *seen, int i) {
    return fmax(ROUNDING * seen->sizes[i], s->faint[i]);
}

/* The same where a motion is as slow as a look over a time. Quantities are then rounded as often as
 * they change by their sizes in this time, not each second; terms that cancel always are. */
static inline double rounding_of_slow_rate(const Switching *s, const Seen *seen, int i, double h) {
    const double each_second = ROUNDING * seen->sizes[i];
    return fmax(s->faint[i] - each_second, 0) + each_second / fmax(1, h);
}

/* The larger one of an argument's first and second derivative. */
static inline double motion_of(const Seen *seen, int i) {
    return fmax(fabs(seen->rates[i]), fabs(seen->seconds[i]));
}

/* Whether neither is more than rounding. */
static inline bool seems_to_rest(const Switching *s, const Seen *seen, int i) {
    return motion_of(seen, i) <= rounding_of_rate(s, seen, i);
}

/* Whether an argument comes to rest within rounding of its boundary: its second derivative brakes
 * it, and does not turn it back. */
static inline bool decays(const Laws *laws, const Switching *s, const Point *from, const Seen *seen,
                          int i) {
    const double rate = seen->rates[i], second = seen->seconds[i];
    Seen later;
    return rate * second < 0 && rate * rate <= 2 * fabs(second) * s->slack[i] &&
           look_after(laws, s, from, seen, -FURTHER * rate / second, &later) &&
           !(fabs(later.rates[i]) > fabs(rate) && later.rates[i] * second > 0);
}

/* Whether arguments still seem to rest a time after a point. */
static inline bool rests_after(const Laws *laws, const Switching *s, const Point *from,
                               const Seen *seen, double h, const bool which[]) {
    Seen later;
    bool rest = look_after(laws, s, from, seen, h, &later);
    for (int i = 0; i < MODES; i++) {
        const bool rests = motion_of(&later, i) <= rounding_of_slow_rate(s, &later, i, h);
        rest = rest && (rests || !which[i]);
    }
    return rest;
}

/* Tells in `departs` on which side the solution leaves boundaries at which arguments seem to rest;
 * `zero`: which ones are at their boundary. */
static inline void look_ahead(const Laws *laws, const Switching *s, const Point *from,
                              const bool zero[], Seen *seen) {
    const double span = s->span > 0 ? s->span : 1, scale = fmin(1, span), last = FARTHEST * scale;
    bool open[MODES + 1] = {false}, any = false;
    Seen looks[3];
    memset(seen->departs, 0, sizeof seen->departs);
    for (int i = 0; i < MODES; i++) {
        const double value = seen->arguments[i];
        const bool at_boundary = zero[i] || value == (laws->relations[i].floor ? round(value) : 0);
        const bool moves = laws->relations[i].of_time || s->state[i] == SLIDES;
        if (!at_boundary || moves) continue;
        if (decays(laws, s, from, seen, i)) seen->rates[i] = seen->seconds[i] = 0;
        open[i] = seems_to_rest(s, seen, i);
        any |= open[i];
    }
    if (!any) return;
    const bool near_rest = rests_after(laws, s, from, seen, last, open);
    /* most of what rests goes on to */
    any = !near_rest || (span > 1 && !rests_after(laws, s, from, seen, FARTHEST * span, open));
    int known = 0;
    const double rounded = fmin(SAME_TIME * fabs(from->t), NEAR_ENOUGH * last);
    const double nearest = fmax(NEAREST * scale, rounded);
    double h = FARTHEST * span; /* the last look, which tells most */
    while (h / FURTHER >= nearest) h /= FURTHER;
    for (; any && h <= FARTHEST * span; h *= FURTHER) {
        looks[0] = looks[1];
        looks[1] = looks[2];
        if (!look_after(laws, s, from, seen, h, &looks[2])) return;
        if (++known < 3) continue;
        for (int i = 0; i < MODES; i++) {
            const double a = looks[0].seconds[i], b = looks[1].seconds[i];
            const double first = h / (FURTHER * FURTHER);
            const double tiny = rounding_of_slow_rate(s, seen, i, first) / fmax(1, first);
            const double most = h <= last ? MOST_GROWTH : MOST_GROWTH_FAR;
            if (!open[i] || !grows_steadily(a, b, looks[2].seconds[i], tiny, most)) continue;
            seen->departs[i] = a > 0 ? INFINITY : -INFINITY;
            open[i] = false;
        }
    }
}

/* Whether an argument at its boundary stays there, as far as looks ahead tell. */
static inline bool rests_on(const Switching *s, const Seen *seen, int i) {
    return seems_to_rest(s, seen, i) && seen->departs[i] == 0;
}

#endif
