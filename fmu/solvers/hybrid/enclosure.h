/* What bounds tell of relations over a part of a step: from spans of states and inputs, the laws
 * know spans of the arguments of relations and of their rates, by interval arithmetic.
 */
#ifndef HYBRID_ENCLOSURE_H
#define HYBRID_ENCLOSURE_H

#include "bounds.h"
#include "quintic.h"
#include "switching.h"

typedef double Sample[NX + NU]; /* states and inputs at a time */

static inline void take_span(const Span *span, int i, Spans *found) {
    found->low[i] = span->low;
    found->high[i] = span->high;
    found->slowest[i] = span->slowest;
    found->fastest[i] = span->fastest;
}

/* Of one state or input. */
static inline void enclose_motion(const Sample *samples, int i, double length, Spans *found) {
    double values[NODES];
    for (int k = 0; k < NODES; k++) values[k] = samples[k][i];
    const Span span = span_of(values, length);
    take_span(&span, i, found);
}

/* Spans of nothing yet. */
static inline void clear_spans(Spans *spans) {
    for (int i = 0; i < NX + NU - MODES; i++) {
        spans->low[i] = spans->slowest[i] = INFINITY;
        spans->high[i] = spans->fastest[i] = -INFINITY;
    }
}

/* Widens spans by those of a cubic, and of what it may be off. */
static inline void span_cubic(const double a, const double b, const double slopes[2], double length,
                              double defect, int i, Spans *spans) {
    const double first = a + length * slopes[0] / 3, last = b - length * slopes[1] / 3;
    const double middle = 3 * (last - first) / length;
    spans->low[i] = fmin(spans->low[i], fmin(fmin(a, b), fmin(first, last)) - length * defect);
    spans->high[i] = fmax(spans->high[i], fmax(fmax(a, b), fmax(first, last)) + length * defect);
    spans->slowest[i] =
        fmin(spans->slowest[i], fmin(middle, fmin(slopes[0], slopes[1])) - 2 * defect);
    spans->fastest[i] =
        fmax(spans->fastest[i], fmax(middle, fmax(slopes[0], slopes[1])) + 2 * defect);
}

/* By how much a guard is within its mode over a part of a step, from the span of its argument. */
static inline Spanned guarded(const double ends[2][2], double sign, double boundary, double slack) {
    const double *first = sign > 0 ? ends[0] : ends[1], *last = sign > 0 ? ends[1] : ends[0];
    return (Spanned){slack + sign * (first[0] - boundary), sign * first[1], sign * last[1]};
}

/* Whether no relation that has bounds leaves its mode between two times at which it is within, and
 * `inside` tells by how much; what slides, or is held, is looked at elsewhere. */
static inline bool stays_within(const Laws *laws, const Switching *s, const Point *at,
                                double length, const Spans *spans, const double a[],
                                const double b[]) {
    double lows[2 * ENCLOSED + 1], highs[2 * ENCLOSED + 1];
    if (ENCLOSED == 0 || any_is(s, SLIDES) || !(length > 0)) return true;
    if (!laws->enclose(laws->owner, at, length, spans, lows, highs)) return false;
    for (int row = 0; row < ENCLOSED; row++) {
        const int i = laws->enclosed[row];
        const double mode = modes_of(at)[i], slack = s->slack[i];
        const double ends[2][2] = {{lows[2 * row], lows[2 * row + 1]},
                                   {highs[2 * row], highs[2 * row + 1]}};
        if (s->state[i] == HELD || mode == 0) continue;
        if (laws->relations[i].floor) {
            const Spanned lower = guarded(ends, 1, mode, slack);
            const Spanned upper = guarded(ends, -1, mode + 1, slack);
            if (s->state[i] == FREE && !(stays_positive(&lower, a[i], b[i], length) &&
                                         stays_positive(&upper, a[i], b[i], length)))
                return false;
        } else {
            const Spanned span = guarded(ends, mode, s->beyond[i], slack);
            if (!stays_positive(&span, a[i], b[i], length)) return false;
        }
    }
    return true;
}

/* The same, with the states and inputs at the nodes between the two times; `off`: by how much the
 * states may be; NULL: by nothing. */
static inline bool sampled_stays_within(const Laws *laws, const Switching *s, const Point *at,
                                        double length, const Sample *samples, const Off *off,
                                        const double a[], const double b[]) {
    Spans spans;
    for (int i = 0; i < NX + NU - MODES; i++) enclose_motion(samples, i, length, &spans);
    for (int i = 0; off && i < NX; i++) {
        spans.low[i] -= off->states[i];
        spans.high[i] += off->states[i];
        spans.slowest[i] -= off->rates[i];
        spans.fastest[i] += off->rates[i];
    }
    return stays_within(laws, s, at, length, &spans, a, b);
}

/* The same in a whole step, from the slopes of its stages. That is cheaper than a polynomial.
 * `spans` are those of the inputs. */
static inline bool stays_by_slopes(const Laws *laws, const Switching *s, const Point *at,
                                   double length, const double *slopes, int stages, Spans *spans,
                                   const double a[], const double b[]) {
    for (int i = 0; i < NX; i++) {
        const Span span = span_of_stages(slopes + i, stages, NX, at->x[i], length);
        take_span(&span, i, spans);
    }
    return stays_within(laws, s, at, length, spans, a, b);
}

#endif
