/* Anderson's acceleration of an iteration w -> g(w), with all earlier iterates of a step.
 *
 * Source  Walker, Ni, SIAM J. Numer. Anal. 49, 2011, 1715-1735; the newest differences first, those
 *         that depend on them dropped, as in Degroote, Bathe, Vierendeels, Comput. Struct. 87,
 * 2009.
 */
#ifndef FIXED_POINT_H
#define FIXED_POINT_H

#include <stdlib.h>

#include "linear.h"

enum { MOST_KEPT = 20 };

typedef struct {
    long long n, kept;
    double *w, *f;                         /* the last iterate, and g(w) - w */
    double *dw[MOST_KEPT], *df[MOST_KEPT]; /* differences of iterates; the newest first */
    double *q[MOST_KEPT];                  /* orthonormal base of df */
} FixedPoint;

static const double DEPENDENT = 1e-9; /* part of a difference that is new, of the whole */

/* Move from w to the next iterate. `f` is g(w) - w. */
static inline void accelerate(FixedPoint *self, double *w, const double *f, int first) {
    const long long n = self->n;
    if (first) self->kept = 0;
    if (!first) {
        const long long last = self->kept < MOST_KEPT ? self->kept++ : MOST_KEPT - 1;
        double *dw = self->dw[last], *df = self->df[last];
        for (long long j = last; j > 0; --j) {
            self->dw[j] = self->dw[j - 1];
            self->df[j] = self->df[j - 1];
        }
        self->dw[0] = dw;
        self->df[0] = df;
        for (long long i = 0; i < n; ++i) {
            dw[i] = w[i] - self->w[i];
            df[i] = f[i] - self->f[i];
        }
    }
    memcpy(self->w, w, (size_t)n * sizeof *w);
    memcpy(self->f, f, (size_t)n * sizeof *f);
    /* least squares f - sum c_j df_j by Gram and Schmidt; then w + f - sum c_j (dw_j + df_j) */
    double c[MOST_KEPT] = {0}, r[MOST_KEPT][MOST_KEPT], right[MOST_KEPT];
    long long place[MOST_KEPT], base = 0;
    for (long long j = 0; j < self->kept && base < n; ++j) {
        double *q = self->q[base];
        memcpy(q, self->df[j], (size_t)n * sizeof *q);
        const double whole = sqrt(dot(n, q, q));
        for (long long k = 0; k < base; ++k) {
            r[k][base] = dot(n, self->q[k], q);
            for (long long i = 0; i < n; ++i) q[i] -= r[k][base] * self->q[k][i];
        }
        const double left = sqrt(dot(n, q, q));
        if (!(left > DEPENDENT * whole)) continue;
        for (long long i = 0; i < n; ++i) q[i] /= left;
        r[base][base] = left;
        right[base] = dot(n, q, f);
        place[base++] = j;
    }
    for (long long k = base - 1; k >= 0; --k) {
        double sum = right[k];
        for (long long l = k + 1; l < base; ++l) sum -= r[k][l] * c[place[l]];
        c[place[k]] = sum / r[k][k];
    }
    for (long long i = 0; i < n; ++i) {
        double next = w[i] + f[i];
        for (long long j = 0; j < self->kept; ++j) next -= c[j] * (self->dw[j][i] + self->df[j][i]);
        w[i] = next;
    }
}

#endif
