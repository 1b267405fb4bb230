/* Explicit Runge-Kutta pair of order 8(5,3) with dense output: one step at a time.
 *
 * Source  Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993,
 *         sections II.4 (starting step, control) and II.10 (error estimate, interpolant).
 */
#ifndef DOP853_H
#define DOP853_H

#include "interpolant.h"

enum { STAGES = 12, END = STAGES, EXTENDED = 16 }; /* slope END is that at the end of the step */

typedef double Slopes[EXTENDED][NX];
typedef void WeightedSum(const double (*k)[NX], double *sum);
typedef void RowOfSums(int row, const double (*k)[NX], double *sum);

/* The coefficients as straight-line code; dop853_coefficients.h, which is generated, fills it. */
typedef struct {
    const double *node;
    RowOfSums *stage, *dense;
    WeightedSum *error_5, *error_3;
} Pair;

static const Pair pair;

static inline double norm(const Ode *ode, const double *values, const double *x) {
    double sum = 0;
    for (int i = 0; i < NX; ++i) {
        const double ratio = values[i] / ode->scale(ode->context, i, x[i]);
        sum += ratio * ratio;
    }
    return sqrt(sum / NX);
}

/* The first trial, of the time: rounding leaves tiny states, whose size says nothing of steps. */
static const double LEAST_FIRST = 1e-12;

/* A step over which the error of order 8 is about the tolerance, from two derivatives. */
static inline double first_step(const Ode *ode, double t, double span, const double *x, Slopes k) {
    const double size = norm(ode, x, x), rate = norm(ode, k[0], x);
    double h = size > 1e-5 && rate > 1e-5 ? 0.01 * size / rate : 1e-6;
    double y[NX], change[NX];
    h = fmin(fmax(h, LEAST_FIRST * fmax(fabs(t), span)), span);
    for (int i = 0; i < NX; ++i) y[i] = x[i] + h * k[0][i];
    if (slope(ode, t + h, y, k[1]) || !is_finite(k[1])) return h;
    for (int i = 0; i < NX; ++i) change[i] = k[1][i] - k[0][i];
    const double steepest = fmax(rate, norm(ode, change, x) / h);
    const double next = steepest > 1e-15 ? pow(0.01 / steepest, 1.0 / 8) : fmax(1e-6, h);
    return fmin(fmin(100 * h, next), span);
}

/* The slopes of one step and the state at its end. Returns 0 where all of them have values. */
static inline int stages(const Ode *ode, double t, double h, const double *x, Slopes k,
                         double *end) {
    double sum[NX];
    for (int s = 1; s <= END; ++s) {
        pair.stage(s, (const double (*)[NX])k, sum);
        for (int i = 0; i < NX; ++i) end[i] = x[i] + h * sum[i];
        if (s == END) break; /* the slope there is found once the step is accepted */
        if (slope(ode, t + pair.node[s] * h, end, k[s])) return 1;
    }
    return !is_finite(end);
}

/* Error of a step in units of the tolerance. */
static inline double error_of(const Ode *ode, double h, const double *x, const double *end,
                              Slopes k) {
    double fifth[NX], third[NX], sum_5 = 0, sum_3 = 0;
    pair.error_5((const double (*)[NX])k, fifth);
    pair.error_3((const double (*)[NX])k, third);
    for (int i = 0; i < NX; ++i) {
        const double unit = ode->scale(ode->context, i, fmax(fabs(x[i]), fabs(end[i])));
        sum_5 += (fifth[i] / unit) * (fifth[i] / unit);
        sum_3 += (third[i] / unit) * (third[i] / unit);
    }
    const double both = sum_5 + 0.01 * sum_3;
    return both > 0 ? fabs(h) * sum_5 / sqrt(NX * both) : 0 * both; /* nan stays nan */
}

/* Where a step of about a size ends: at a goal that is hardly beyond. */
static inline double step_end(double t, double size, double goal) {
    return t + 1.01 * size >= goal ? goal : t + size;
}

/* Tries such a step. Returns its error, NaN where it has no value; `after` and `end` are the time
 * and the state at its end. */
static inline double try_step(const Ode *ode, double t, double size, double goal, const double *x,
                              Slopes k, double *after, double *end) {
    *after = step_end(t, size, goal);
    const double h = *after - t; /* as time is rounded: states must not run away from it */
    return stages(ode, t, h, x, k, end) ? NAN : error_of(ode, h, x, end, k);
}

/* A step from where one begins, with its first slope, to another time. Returns 0 with a value. */
static inline int fresh_step(const Ode *ode, double from, double t, const double *x, Slopes k,
                             double *end, double *error) {
    Slopes own;
    memcpy(own[0], k[0], sizeof own[0]);
    memcpy(end, x, NX * sizeof *x);
    *error = 0;
    if (!(t > from)) return 0;
    const int lost = stages(ode, from, t - from, x, own, end);
    if (!lost) *error = error_of(ode, t - from, x, end, own);
    return lost;
}

static inline int interpolate(const Ode *ode, double t, double h, const double *x,
                              const double *end, Slopes k, Interpolant *p) {
    double sum[NX], y[NX];
    for (int s = END + 1; s < EXTENDED; ++s) {
        pair.stage(s, (const double (*)[NX])k, sum);
        for (int i = 0; i < NX; ++i) y[i] = x[i] + h * sum[i];
        if (slope(ode, t + pair.node[s] * h, y, k[s])) return 1;
    }
    p->t = t;
    p->h = h;
    for (int i = 0; i < NX; ++i) {
        const double change = end[i] - x[i], bend = h * k[0][i] - change;
        p->row[0][i] = x[i];
        p->row[1][i] = change;
        p->row[2][i] = bend;
        p->row[3][i] = change - h * k[END][i] - bend;
    }
    for (int j = 0; j < 4; ++j) {
        pair.dense(j, (const double (*)[NX])k, sum);
        for (int i = 0; i < NX; ++i) p->row[4 + j][i] = h * sum[i];
    }
    return 0;
}

/* The step times about the largest eigenvalue, from the last stage and the end, which are near each
 * other (volume II, section IV.2). */
static inline double stiffness_of(const Ode *ode, double h, const double *x, const double *end,
                                  Slopes k) {
    double sum[NX], slopes[NX], states[NX];
    pair.stage(STAGES - 1, (const double (*)[NX])k, sum);
    for (int i = 0; i < NX; ++i) {
        slopes[i] = k[END][i] - k[STAGES - 1][i];
        states[i] = end[i] - (x[i] + h * sum[i]);
    }
    const double distance = norm(ode, states, x);
    return distance > 0 ? h * norm(ode, slopes, x) / distance : 0;
}

/* What the size of a step is multiplied by after an error. */
static inline double growth(double error, int rejected) {
    const double most = error > 1 || rejected ? 1.0 : 6.0;
    return fmin(most, fmax(1.0 / 3, 0.9 * pow(error, -1.0 / 8)));
}

/* The size to try after one that was not accepted. */
static inline double smaller_size(double h, double error, int rejected) {
    return h * (error > 1 ? growth(error, rejected) : 0.1);
}

#endif
