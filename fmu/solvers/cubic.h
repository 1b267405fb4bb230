/* The cubic through values and slopes at both ends of a step. */
#ifndef CUBIC_H
#define CUBIC_H

#include <math.h>

/* Its value at a share s of the length h, and its slope. */
static inline double on_cubic(double a, double b, double slope_at_a, double slope_at_b, double h,
                              double s, double *slope) {
    const double r = 1 - s;
    *slope = 6 * s * r * (b - a) / h + r * (1 - 3 * s) * slope_at_a + s * (1 - 3 * r) * slope_at_b;
    return r * r * (1 + 2 * s) * a + s * s * (1 + 2 * r) * b +
           h * s * r * (r * slope_at_a - s * slope_at_b);
}

/* Between which values it stays, which are Bernstein coefficients. */
static inline void box_of_cubic(double a, double b, double slope_at_a, double slope_at_b, double h,
                                double *low, double *high) {
    const double first = a + h * slope_at_a / 3, last = b - h * slope_at_b / 3;
    *low = fmin(fmin(a, b), fmin(first, last));
    *high = fmax(fmax(a, b), fmax(first, last));
}

#endif
