/* What bounds tell of relations over a part of a step. States and inputs are polynomials there:
 * they stay between their Bernstein coefficients, and so do their rates. From these spans, the laws
 * know spans of the arguments of relations and of their rates, by interval arithmetic.
 *
 * Source  Farouki, The Bernstein polynomial basis, Computer Aided Geometric Design 29, 2012.
 */
#ifndef HYBRID_ENCLOSURE_H
#define HYBRID_ENCLOSURE_H

#include "switching.h"

/* Between which values what is positive within a mode, and its rate, stay over a span of time. */
typedef struct {
    double low, slowest, fastest;
} Spanned;

/* Whether it is positive between two times at which it is not negative. Unless its least value is,
 * it may not turn, or not come down to 0 and back as fast as its rate allows. */
static inline bool stays_positive(const Spanned *span, double a, double b, double length) {
    if (span->low >= 0) return true;
    if (!isfinite(span->slowest) || !isfinite(span->fastest)) return false;
    return span->slowest >= 0 || span->fastest <= 0 ||
           span->fastest * a - span->slowest * b + span->slowest * span->fastest * length > 0;
}

#if ENCLOSED > 0

enum { NODES = 8 }; /* as many as determine a polynomial of degree 7, that of dop853.h */

typedef double Sample[NX + NU]; /* states and inputs at a time */

/* Bernstein coefficients from the values at equidistant nodes; the other half is symmetric. */
static const double COEFFICIENTS[NODES / 2][NODES] = {
    {1},
    {-223.0 / 140, 7, -21.0 / 2, 35.0 / 3, -35.0 / 4, 21.0 / 5, -7.0 / 6, 1.0 / 7},
    {7159.0 / 3780, -721.0 / 60, 1211.0 / 40, -4123.0 / 108, 91.0 / 3, -301.0 / 20, 4613.0 / 1080,
     -223.0 / 420},
    {-42881.0 / 25200, 11179.0 / 900, -45731.0 / 1200, 11207.0 / 180, -8057.0 / 144, 8939.0 / 300,
     -31871.0 / 3600, 7159.0 / 6300},
};

static inline double coefficient(int k, int j) {
    return k < NODES / 2 ? COEFFICIENTS[k][j] : COEFFICIENTS[NODES - 1 - k][NODES - 1 - j];
}

static inline double node_between(double begin, double end, int k) {
    return k < NODES - 1 ? begin + (end - begin) * k / (NODES - 1) : end;
}

/* Of one state or input; what rests does so exactly. */
static inline void enclose_motion(const Sample *samples, int i, double length, Spans *found) {
    double before = 0, low = 0, high = 0, slowest = INFINITY, fastest = -INFINITY;
    for (int k = 1; k < NODES; k++) {
        double sum = 0;
        for (int j = 1; j < NODES; j++) sum += coefficient(k, j) * (samples[j][i] - samples[0][i]);
        const double rate = (NODES - 1) * (sum - before) / length;
        low = fmin(low, sum);
        high = fmax(high, sum);
        slowest = fmin(slowest, rate);
        fastest = fmax(fastest, rate);
        before = sum;
    }
    found->low[i] = samples[0][i] + low;
    found->high[i] = samples[0][i] + high;
    found->slowest[i] = slowest;
    found->fastest[i] = fastest;
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
    double lows[2 * ENCLOSED], highs[2 * ENCLOSED];
    if (is_sliding(s) || !(length > 0)) return true;
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

/* The same, with the states and inputs at the nodes between the two times. */
static inline bool sampled_stays_within(const Laws *laws, const Switching *s, const Point *at,
                                        double length, const Sample *samples, const double a[],
                                        const double b[]) {
    Spans spans;
    for (int i = 0; i < NX + NU - MODES; i++) enclose_motion(samples, i, length, &spans);
    return stays_within(laws, s, at, length, &spans, a, b);
}

#endif

#endif
