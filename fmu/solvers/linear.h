/* Small dense linear algebra, by rows. */
#ifndef LINEAR_H
#define LINEAR_H

#include <math.h>
#include <string.h>

/* Solve n equations a x = b by elimination with pivots; b becomes x. Returns 0, or
 * the number of the first column that those before it determine, counted from 1. */
static inline long long solve_dense(long long n, double *a, double *b) {
    for (long long c = 0; c < n; ++c) {
        long long pivot = c;
        for (long long r = c + 1; r < n; ++r)
            if (fabs(a[r * n + c]) > fabs(a[pivot * n + c])) pivot = r;
        if (!(fabs(a[pivot * n + c]) > 0)) return c + 1;
        for (long long k = c; pivot != c && k < n; ++k) {
            const double swapped = a[c * n + k];
            a[c * n + k] = a[pivot * n + k];
            a[pivot * n + k] = swapped;
        }
        const double right = b[c];
        b[c] = b[pivot];
        b[pivot] = right;
        for (long long r = c + 1; r < n; ++r) {
            const double share = a[r * n + c] / a[c * n + c];
            if (share == 0) continue;
            for (long long k = c; k < n; ++k) a[r * n + k] -= share * a[c * n + k];
            b[r] -= share * b[c];
        }
    }
    for (long long r = n - 1; r >= 0; --r) {
        for (long long k = r + 1; k < n; ++k) b[r] -= a[r * n + k] * b[k];
        b[r] /= a[r * n + r];
    }
    return 0;
}

static inline double dot(long long n, const double *a, const double *b) {
    double sum = 0;
    for (long long i = 0; i < n; ++i) sum += a[i] * b[i];
    return sum;
}

#endif
