/* Sine and cosine that give identical bits on every computer, which those of C libraries do not.

   An angle is reduced by a multiple of pi/2 whose parts are exact (Cody and Waite, Software Manual
   for the Elementary Functions, 1980). Taylor's series take the rest, at most pi/4, and its tail
   beyond double precision. The error is below 0.8 units in the last place. */
#ifndef SINE_H
#define SINE_H

#include <math.h>

#if defined __clang__
#pragma STDC FP_CONTRACT OFF /* others do not contract in standard C */
#endif

/* From there on, a multiple of pi/2 is not exact: the C library. */
#define LARGEST_ANGLE 1e6

typedef struct {
    double angle, tail;
    int quadrant;
} Rest;

static inline Rest rest_of(double x) {
    const double shift = 0x1.8p52, n = x * 0x1.45f306dc9c883p-1 + shift, k = n - shift;
    const double a = x - k * 0x1.921fb544p+0, b = k * 0x1.0b4611a6p-34, c = a - b;
    const double d = k * 0x1.3198a2e037073p-69 - ((a - c) - b), r = c - d;
    return (Rest){r, (c - r) - d, (int)k & 3};
}

static inline double sine_of(const Rest *rest) {
    const double x = rest->angle, z = x * x, w = z * z, cube = z * x;
    const double odd = 1.0 / 5040 + w * (1.0 / 39916800 + w * (1.0 / 1307674368000));
    const double even =
        1.0 / 120 + w * (1.0 / 362880 + w * (1.0 / 6227020800 + w * (1.0 / 355687428096000)));
    const double most = z * (0.5 * rest->tail - cube * (even - z * odd)) - rest->tail;
    return x - (most + cube * (1.0 / 6));
}

static inline double cosine_of(const Rest *rest) {
    const double x = rest->angle, z = x * x, w = z * z, half = 0.5 * z, one = 1 - half;
    const double odd = 1.0 / 720 + w * (1.0 / 3628800 + w * (1.0 / 87178291200));
    const double even =
        1.0 / 24 + w * (1.0 / 40320 + w * (1.0 / 479001600 + w * (1.0 / 20922789888000)));
    return one + (((1 - one) - half) + (z * (z * (even - z * odd)) - x * rest->tail));
}

static inline double turned(const Rest *rest, int quadrant) {
    const double size = quadrant & 1 ? cosine_of(rest) : sine_of(rest);
    return quadrant & 2 ? -size : size;
}

static inline double same_sin(double x) {
    if (!(fabs(x) < LARGEST_ANGLE)) return sin(x);
    const Rest rest = rest_of(x);
    return turned(&rest, rest.quadrant);
}

static inline double same_cos(double x) {
    if (!(fabs(x) < LARGEST_ANGLE)) return cos(x);
    const Rest rest = rest_of(x);
    return turned(&rest, rest.quadrant + 1);
}

#define sin same_sin
#define cos same_cos

#endif
