/* The first place within a step at which a margin is negative, such as that of a relation within
 * its mode. Bounds over a part of the step prove that none is, or the part is halved. What has no
 * bounds is looked at in several places, and at the least values between them, so that two
 * crossings are seen, too.
 */
#ifndef MARGINS_H
#define MARGINS_H

#include <float.h>

#include "bounds.h"

enum { PLACES = 9, MOST_HALVINGS = 100, GUARDS = MODES > 0 ? MODES : 1 };

/* What is positive while relations stay in their modes, or a limit holds, and its rates at a time.
   What has no value is no event: the solver rejects such steps itself. */
typedef struct {
    double t, inside[GUARDS], rates[GUARDS];
} Place;

static inline void note_no_event(double t, Place *found) {
    found->t = t;
    for (int i = 0; i < GUARDS; ++i) {
        found->inside[i] = 1;
        found->rates[i] = 0;
    }
}

typedef void LookAt(void *motion, double t, Place *found);

/* Whether bounds prove that no relation is outside between two places where none is. */
typedef bool Stays(void *motion, const Place *a, const Place *b);

/* Least value of a dip that is searched, as a share of its larger end: on the cubic of a whole
   step, and of a part of it. */
static const double SHALLOW = 0.5, SHALLOW_PART = 0.2;

static inline int outside(const Place *place) {
    for (int i = 0; i < GUARDS; ++i)
        if (place->inside[i] < 0) return i;
    return -1;
}

/* Moves a place that is outside back to where that begins, to the rounding of time, after one that
   is not; the place before it. */
static inline Place narrow(LookAt *look, void *motion, Place low, Place *high) {
    for (int n = 0; n < MOST_HALVINGS; ++n) {
        const double middle = low.t + (high->t - low.t) / 2;
        Place place;
        if (!(middle > low.t && middle < high->t)) break;
        look(motion, middle, &place);
        *(outside(&place) >= 0 ? high : &low) = place;
    }
    return low;
}

/* May a relation that first falls and then rises have been outside between two places? */
static inline int may_dip(const Place *a, const Place *b, int i, double shallow) {
    if (!(a->rates[i] < 0 && b->rates[i] > 0)) return 0;
    const double h = b->t - a->t, most = fmax(a->inside[i], b->inside[i]);
    double least = most;
    for (int k = 1; k < PLACES; ++k) { /* on the cubic */
        const double s = (double)k / PLACES, r = 1 - s;
        const double ends = r * r * (1 + 2 * s) * a->inside[i] + s * s * (1 + 2 * r) * b->inside[i];
        least = fmin(least, ends + h * s * r * (r * a->rates[i] - s * b->rates[i]));
    }
    return least < shallow * most;
}

/* The place where a relation is least. */
static inline Place bottom(LookAt *look, void *motion, int i, Place a, Place b) {
    Place place;
    for (int n = 0; n < MOST_HALVINGS; ++n) {
        const double middle = a.t + (b.t - a.t) / 2;
        if (!(middle > a.t && middle < b.t)) break;
        look(motion, middle, &place);
        if (place.inside[i] < 0) return place;
        *(place.rates[i] < 0 ? &a : &b) = place;
    }
    return b;
}

/* Moves a part, at whose ends no relation is outside, on to the first one that ends outside; false
 * if there is none. */
static inline bool find_outside(LookAt *look, Stays *stays, void *motion, Place *a, Place *b,
                                int *parts) {
    const Place last = *b;
    while (*parts > 0 && a->t < last.t) {
        const double length = b->t - a->t, middle = a->t + length / 2;
        const bool is_shortest = !(middle > a->t && middle < b->t);
        const bool goes_on = is_shortest || stays(motion, a, b);
        --*parts;
        if (goes_on) *a = *b;
        const double t = goes_on ? a->t + 2 * length : middle;
        if (t < last.t)
            look(motion, t, b);
        else
            *b = last;
        if (outside(b) >= 0) return true;
    }
    return false;
}

/* The relation that is outside first after a place, up to a time, or -1; `found`: where it is so,
 * or the end. */
static inline int crossing_between(LookAt *look, Stays *stays, void *motion, Place before,
                                   double end, Place *found) {
    const double from = before.t;
    int parts = MOST_ENCLOSED;
    *found = before;
    for (int k = 1; k <= PLACES && outside(found) < 0; ++k) {
        before = *found;
        look(motion, k < PLACES ? from + (end - from) * k / PLACES : end, found);
        bool left = outside(found) >= 0;
        for (int i = 0; i < GUARDS && !left; ++i) {
            if (!may_dip(&before, found, i, SHALLOW_PART)) continue;
            const Place least = bottom(look, motion, i, before, *found);
            left = least.inside[i] < 0;
            if (left) *found = least;
        }
        left = left || find_outside(look, stays, motion, &before, found, &parts);
        while (left) { /* it may have been outside before, too */
            Place inside = narrow(look, motion, before, found);
            left = find_outside(look, stays, motion, &before, &inside, &parts) &&
                   found->t - inside.t > LOCATED * fabs(found->t);
            if (left) *found = inside;
        }
    }
    return outside(found);
}

/* When a single margin is outside first, on a motion between two times; infinite: never. */
static inline double first_crossing(LookAt *look, Stays *stays, void *motion, double begin,
                                    double end) {
    Place from, to, found;
    look(motion, begin, &from);
    look(motion, end, &to);
    if (outside(&from) >= 0) return begin;
    if (outside(&to) < 0 && stays(motion, &from, &to)) return INFINITY;
    return crossing_between(look, stays, motion, from, end, &found) < 0 ? INFINITY : found.t;
}

/* -- a margin without bounds and rates: a few looks at a step, and closer ones where a parabola may
   reach 0 */

enum { LOOKS = 4, MOST_CLOSER_LOOKS = 40 };

/* Margins that are positive may reach 0 where their least is below this share of their largest. */
static const double NEARLY_SHALLOW = 0.5;

/* The times that divide a span into equal parts, without its start. */
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
static inline double closer_look(LookAt *look, void *motion, double begin, double end) {
    double t[LOOKS + 1], m[LOOKS];
    bool found = false;
    for (int n = 0; n < MOST_CLOSER_LOOKS; ++n) {
        int least = 0, first = 0;
        t[0] = begin;
        places_within(begin, end, t + 1);
        for (int k = 0; k < LOOKS; ++k) {
            Place place;
            look(motion, t[k + 1], &place);
            m[k] = place.inside[0];
        }
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
 * known at the start, where it is positive, and at the LOOKS places of `places_within`. */
static inline double first_outside(LookAt *look, void *motion, double begin, double end,
                                   const double known[]) {
    double t[LOOKS + 1];
    t[0] = begin;
    places_within(begin, end, t + 1);
    for (int k = 1; k <= LOOKS; ++k) {
        double when = INFINITY;
        if (!(known[k] > 0))
            when = closer_look(look, motion, t[k - 1], t[k]);
        else if (k > 1 && may_reach_zero(known + k - 2, k == 2, k == LOOKS))
            when = closer_look(look, motion, t[k - 2], t[k]);
        if (when < INFINITY || !(known[k] > 0)) return fmin(when, t[k]);
    }
    return INFINITY;
}

#endif
