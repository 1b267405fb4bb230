/* What bounds prove of a margin over a part of a step. States and inputs are polynomials there:
 * they stay between their Bernstein coefficients, and so do their rates. From these spans follow
 * those of the margin, by interval arithmetic.
 *
 * Source  Farouki, The Bernstein polynomial basis, Computer Aided Geometric Design 29, 2012.
 */
#ifndef BOUNDS_H
#define BOUNDS_H

#include <float.h>
#include <math.h>
#include <stdbool.h>

static const double LOCATED = 8 * DBL_EPSILON; /* relative distance of located times that are one */
enum { MOST_ENCLOSED = 4096 }; /* parts of a step; what touches its boundary is never proven */

/* Share of its width by which a box grows on each side, so that it serves for later steps. */
#define WIDER 0.25

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

enum { NODES = 8 }; /* as many as determine a polynomial of degree 7, that of dop853.h */

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

/* Between which values a polynomial and its rate stay, from its values at the nodes; what rests
 * does so exactly. */
typedef struct {
    double low, high, slowest, fastest;
} Span;

static inline Span span_of(const double values[NODES], double length) {
    Span found = {0, 0, INFINITY, -INFINITY};
    double before = 0;
    for (int k = 1; k < NODES; k++) {
        double sum = 0;
        for (int j = 1; j < NODES; j++) sum += coefficient(k, j) * (values[j] - values[0]);
        const double rate = (NODES - 1) * (sum - before) / length;
        found.low = fmin(found.low, sum);
        found.high = fmax(found.high, sum);
        found.slowest = fmin(found.slowest, rate);
        found.fastest = fmax(found.fastest, rate);
        before = sum;
    }
    found.low += values[0];
    found.high += values[0];
    return found;
}

/* The same over a step, from the slopes of its stages, which are `apart`: it goes half as far
 * beyond them again. */
static inline Span span_of_stages(const double *slopes, int stages, int apart, double begin,
                                  double length) {
    double low = slopes[0], high = low;
    for (int k = 1; k < stages; k++) {
        low = fmin(low, slopes[k * apart]);
        high = fmax(high, slopes[k * apart]);
    }
    const double more = (high - low) / 2, slowest = low - more, fastest = high + more;
    return (Span){begin + length * fmin(slowest, 0), begin + length * fmax(fastest, 0), slowest,
                  fastest};
}

#endif
