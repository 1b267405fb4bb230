/* The first time within a step at which a margin is not positive. Margins of validity conditions
 * have values, but no modes and no rates: nothing is frozen and no step ends there. Bounds prove
 * that they are positive over a part of the step, or it is divided. Margins without bounds are
 * looked at in several places at once, and more closely where a parabola through three of them may
 * reach 0.
 */
#ifndef MARGINS_H
#define MARGINS_H

#include <float.h>

#include "bounds.h"

enum { LOOKS = 4, MOST_CLOSER_LOOKS = 40 };

/* Margins that are positive may reach 0 where their least is below this share of their largest. */
static const double NEARLY_SHALLOW = 0.5;

/* A margin at LOOKS times. */
typedef void Measure(void *motion, const double times[], double margins[]);

/* The times that divide a span into equal parts, without its begin. */
static inline void places_within(double begin, double end, double times[]) {
    for (int k = 1; k < LOOKS; ++k) times[k - 1] = begin + (end - begin) * k / LOOKS;
    times[LOOKS - 1] = end;
}

/* May the parabola through three equidistant margins reach 0 near the middle one, or beyond it
 * where no neighbors follow? */
static inline bool may_reach_zero(const double m[], bool first, bool last) {
    const double bend = (m[0] - 2 * m[1] + m[2]) / 2, tilt = (m[2] - m[0]) / 2;
    const double place = -tilt / (2 * bend), least = m[1] + tilt * place / 2;
    return bend > 0 && place >= (first ? -1 : -0.5) && place <= (last ? 1 : 0.5) &&
           least < NEARLY_SHALLOW * fmax(m[0], m[2]);
}

/* Closer and closer looks at a span whose begin is inside; infinite if no place is outside. */
static inline double closer_look(Measure *measure, void *motion, double begin, double end) {
    double t[LOOKS + 1], m[LOOKS];
    bool found = false;
    for (int n = 0; n < MOST_CLOSER_LOOKS; ++n) {
        int least = 0, first = 0;
        t[0] = begin;
        places_within(begin, end, t + 1);
        measure(motion, t + 1, m);
        while (first < LOOKS && m[first] > 0) ++first;
        for (int k = 1; k < LOOKS - 1; ++k)
            if (m[k] < m[least]) least = k;
        if (first == LOOKS && !(m[least] < NEARLY_SHALLOW * fmax(m[0], m[LOOKS - 1]))) break;
        found = first < LOOKS;
        begin = t[found ? first : least];
        end = t[found ? first + 1 : least + 2];
        if (end - begin <= 2 * DBL_EPSILON * fabs(end)) break;
    }
    return found ? end : INFINITY;
}

/* The first time in a span at which a margin is not positive; infinite if it is everywhere. It is
 * known at the begin, where it is positive, and at the LOOKS places of `places_within`. */
static inline double first_outside(Measure *measure, void *motion, double begin, double end,
                                   const double known[]) {
    double t[LOOKS + 1];
    t[0] = begin;
    places_within(begin, end, t + 1);
    for (int k = 1; k <= LOOKS; ++k) {
        double when = INFINITY;
        if (!(known[k] > 0))
            when = closer_look(measure, motion, t[k - 1], t[k]);
        else if (k > 1 && may_reach_zero(known + k - 2, k == 2, k == LOOKS))
            when = closer_look(measure, motion, t[k - 2], t[k]);
        if (when < INFINITY || !(known[k] > 0)) return fmin(when, t[k]);
    }
    return INFINITY;
}

/* Between which values a margin and its rate stay from one time to another. */
typedef Spanned Enclose(void *motion, double begin, double end);

/* The first time in a span at which a margin is not positive, by bounds; infinite if it is
 * everywhere. It is positive at the begin, and known at the end; so many parts are tried at most.
 */
static inline double first_unproven(Measure *measure, Enclose *enclose, void *motion, double begin,
                                    double end, double a, double b, int *parts) {
    double t[LOOKS + 1], m[LOOKS + 1], when = INFINITY;
    const bool is_shortest = end - begin <= 2 * DBL_EPSILON * fabs(end);
    if (is_shortest && !(b > 0)) return end;
    if (b > 0) {
        if (is_shortest || --*parts < 0) return INFINITY;
        const Spanned span = enclose(motion, begin, end);
        if (stays_positive(&span, a, b, end - begin)) return INFINITY;
    }
    t[0] = begin;
    m[0] = a;
    places_within(begin, end, t + 1);
    measure(motion, t + 1, m + 1);
    m[LOOKS] = b;
    for (int k = 1; k <= LOOKS && when == INFINITY; ++k)
        when = first_unproven(measure, enclose, motion, t[k - 1], t[k], m[k - 1], m[k], parts);
    return when;
}

#endif
