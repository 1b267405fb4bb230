/* A step on polynomials of degree 5: the cubics through both of its ends, and what the equations
 * tell at two places where the slope of a cubic is off most. Each look at these places makes the
 * motion an order more accurate, as far as it makes sense.
 *
 * Source  Enright, Jackson, Norsett & Thomsen, Interpolants for Runge-Kutta formulas, ACM
 *         Transactions on Mathematical Software 12, 1986.
 */
#ifndef QUINTIC_H
#define QUINTIC_H

#include <float.h>
#include <stdbool.h>

#include "cubic.h"
#include "ode.h"

/* By how much states, and their rates, may be off. */
typedef struct {
    double states[NX + 1], rates[NX + 1];
} Off;

typedef struct Quintic {
    double t, h;
    const double *ends[2], *slopes[2];
    Slope *slope; /* dx/dt by the equations */
    void *owner;
    double even[NX + 1], odd[NX + 1]; /* h s^2 r^2 (even + odd (s - 1/2)) adds to the cubic */
    Off off;                          /* what the last look has changed at most */
    double change;                    /* the same, relative to the states; 0: none yet */
    int looks;                        /* that are left */
} Quintic;

/* Looks that make sense where the error of a step is of this order, more than that of a cubic. */
static inline int looks_for(int order) {
    const int most = 3; /* then it is as near as it gets by two places */
    return order - 3 < most ? order - 3 : most;
}

/* How far from the middle of a step it is looked at: the root of 1/12. */
static const double FROM_MIDDLE = 0.28867513459481288;

static inline void on_quintic(const Quintic *self, double t, double *x, double *dx) {
    const double s = (t - self->t) / self->h, m = s * (1 - s), way = s - 0.5;
    for (int i = 0; i < NX; ++i) {
        const double bend = self->even[i] + self->odd[i] * way;
        x[i] = on_cubic(self->ends[0][i], self->ends[1][i], self->slopes[0][i], self->slopes[1][i],
                        self->h, s, &dx[i]) +
               self->h * m * m * bend;
        dx[i] += m * m * self->odd[i] - 4 * m * way * bend;
    }
}

/* Back to the cubic, where the equations tell nothing of the motion. */
static inline bool give_up(Quintic *self) {
    memset(self->even, 0, sizeof self->even);
    memset(self->odd, 0, sizeof self->odd);
    self->looks = 0;
    return false;
}

/* Makes it more accurate; false where it is as accurate as it gets. A step that is too long for the
 * equations, as where a solver is not stable, changes more with each look. */
static inline bool sharpen(Quintic *self) {
    double missing[2][NX + 1], change = 0;
    if (self->looks <= 0) return false;
    --self->looks;
    for (int k = 0; k < 2; ++k) {
        double x[NX + 1], dx[NX + 1];
        const double t = self->t + self->h * (0.5 + (k ? FROM_MIDDLE : -FROM_MIDDLE));
        on_quintic(self, t, x, dx);
        if (self->slope(self->owner, t, x, missing[k]) || !is_finite(missing[k]))
            return give_up(self);
        for (int i = 0; i < NX; ++i) missing[k][i] -= dx[i];
    }
    for (int i = 0; i < NX; ++i) {
        const double even = 9 * FROM_MIDDLE * (missing[0][i] - missing[1][i]);
        const double odd = -18 * (missing[0][i] + missing[1][i]);
        self->even[i] += even;
        self->odd[i] += odd;
        self->off.states[i] = self->h * (fabs(even) / 16 + fabs(odd) / 100);
        self->off.rates[i] = fabs(even) / 5 + fabs(odd) / 16;
        const double size = fmax(fabs(self->ends[0][i]), fabs(self->ends[1][i])) +
                            self->h * fmax(fabs(self->slopes[0][i]), fabs(self->slopes[1][i]));
        change = fmax(change, self->off.states[i] / size);
    }
    if (self->change > 0 && change > self->change) return give_up(self);
    if (change <= 4 * DBL_EPSILON) self->looks = 0;
    self->change = change;
    return true;
}

static inline void sharpen_fully(Quintic *self) {
    while (self && sharpen(self)) {
    }
}

#endif
