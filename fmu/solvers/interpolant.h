/* The interpolant of one step from t over h, in Hairer's nested form (see dop853.h). */
#ifndef INTERPOLANT_H
#define INTERPOLANT_H

#include "ode.h"

typedef struct {
    double t, h;
    double row[8][NX];
} Interpolant;

static inline void evaluate(const Interpolant *p, double t, double *x) {
    const double s = (t - p->t) / p->h, r = 1 - s;
    for (int i = 0; i < NX; ++i) {
        double value = p->row[7][i];
        for (int j = 6; j >= 0; --j) value = p->row[j][i] + (j % 2 ? r : s) * value;
        x[i] = value;
    }
}

/* States and their rates. */
static inline void evaluate_both(const Interpolant *p, double t, double *x, double *dx) {
    const double s = (t - p->t) / p->h, r = 1 - s;
    for (int i = 0; i < NX; ++i) {
        x[i] = p->row[7][i];
        dx[i] = 0;
    }
    for (int j = 6; j >= 0; --j) {
        const double factor = j % 2 ? r : s, sign = j % 2 ? -1 : 1;
        for (int i = 0; i < NX; ++i) {
            dx[i] = factor * dx[i] + sign * x[i];
            x[i] = p->row[j][i] + factor * x[i];
        }
    }
    const double per_time = 1 / p->h;
    for (int i = 0; i < NX; ++i) dx[i] *= per_time;
}

/* Between which values they stay, if all rows are finite: each factor is from 0 to 1. */
static inline void box_of(const Interpolant *p, double *low, double *high) {
    for (int i = 0; i < NX; ++i) {
        low[i] = high[i] = p->row[7][i];
        for (int j = 6; j >= 0; --j) {
            low[i] = p->row[j][i] + (low[i] < 0 ? low[i] : 0);
            high[i] = p->row[j][i] + (high[i] > 0 ? high[i] : 0);
        }
    }
}

#endif
