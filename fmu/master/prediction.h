/* The next point of the interface by the points of the past, and points as vectors. */
#ifndef PREDICTION_H
#define PREDICTION_H

#include "interface.h"

enum { MOST_POINTS = 3 }; /* of a prediction */

static const double LONGER = 2.0; /* of macro steps, times the one before */

/* Whether the past tells about the next macro step: one much shorter than it tells rounding. */
static inline int has_near_past(const Coupling *self) {
    const double before = self->known ? self->now.t - self->past[0].t : 0;
    return self->next.t - self->now.t <= 1.01 * LONGER * before;
}

/* The polynomial through values and rates at the newest points, the present one among them, at the
 * next point; held inputs stay. */
static inline void predict(const Coupling *self, int points, Interface *next) {
    const Interface *at[] = {&self->now, &self->past[0], &self->past[1]};
    const int n = 2 * (int)fmin((double)self->known + 1, points);
    for (long long k = 0; k < self->system->inputs; ++k) {
        double d[2 * MOST_POINTS], value = 0, rate = 0; /* divided differences, each point twice */
        for (int i = 0; i < n; ++i) d[i] = at[i / 2]->u[k];
        for (int order = 1; order < n; ++order)
            for (int i = n - 1; i >= order; --i) {
                const double apart = at[i / 2]->t - at[(i - order) / 2]->t;
                d[i] = apart != 0 ? (d[i] - d[i - 1]) / apart : at[i / 2]->r[k];
            }
        for (int i = n - 1; i >= 0; --i) {
            const double since = next->t - at[i / 2]->t;
            rate = value + since * rate;
            value = d[i] + since * value;
        }
        const int stays = self->system->held[k] || self->jumps[k] != 0;
        next->u[k] = stays ? self->now.u[k] : value;
        next->r[k] = stays ? 0 : rate;
    }
}

static inline void copy(const Coupling *self, Interface *to, const Interface *from) {
    const size_t size = (size_t)self->system->inputs * sizeof *to->u;
    to->t = from->t;
    memcpy(to->u, from->u, size);
    memcpy(to->r, from->r, size);
}

/* The interface as one vector without units. */
static inline void as_vector(const Coupling *self, const Interface *at, double *w) {
    const long long m = self->system->inputs;
    const double h = self->next.t - self->now.t;
    for (long long k = 0; k < m; ++k) {
        const double size = size_of(self->system, k, self->now.u[k]);
        w[k] = at->u[k] / size;
        w[m + k] = h * at->r[k] / size;
    }
}

static inline void from_vector(const Coupling *self, const double *w, Interface *at) {
    const long long m = self->system->inputs;
    const double h = self->next.t - self->now.t;
    for (long long k = 0; k < m; ++k) {
        const double size = size_of(self->system, k, self->now.u[k]);
        at->u[k] = self->system->held[k] ? self->now.u[k] : w[k] * size; /* without rounding */
        at->r[k] = w[m + k] * size / h;
    }
}

static inline double largest(long long n, const double *a, const double *b) {
    double found = 0;
    for (long long i = 0; i < n; ++i) {
        const double difference = fabs(b ? a[i] - b[i] : a[i]);
        if (!(difference <= found)) found = difference;
        if (!isfinite(found)) return found;
    }
    return found;
}

#endif
