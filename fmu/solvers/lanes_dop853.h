/* Many runs of one model, a run in each lane: Runge-Kutta pair of order 8(5,3), dense output.
 *
 * Every lane has its own time, step size and error; a lane whose run has ended takes the next one.
 * All arithmetic is lane by lane, so that a run does not depend on what its neighbors do.
 *
 * Source  Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993,
 *         sections II.4 (starting step, control) and II.10 (error estimate, interpolant).
 */
#ifndef LANES_DOP853_H
#define LANES_DOP853_H

#include <float.h>
#include <stdint.h>
#include <stdlib.h>

#include "lanes_limits.h"

enum { REPORT = 9 };
enum { ENDED, TOO_MANY_STEPS, STEP_TOO_SMALL, INCONSISTENT, NOT_FINITE, HALTED, OUTSIDE };

#define MOST_TRIALS 100000               /* per output interval */
static const double LEAST_FIRST = 1e-12; /* as in dop853.h */

/* What is to be run; arrays by run, then by time. Threads share one batch. */
typedef struct {
    long long runs, points;
    const double *x0, *nominal, *u, *p, *grid; /* the grid begins with the start time */
    double relative, absolute, largest;        /* step */
    double line, few_digits; /* how long, and to which absolute tolerance, a line is looked for */
    double *out, *report;    /* NaN beyond the last good time */
    long long *next;         /* run to begin next */
    const volatile int *stop;
    long long stop_outside; /* whether a run ends where it leaves the limits */
    double *steps;          /* step sizes that runs begin with, 0 for none, and end with; or NULL */
} Batch;

static void slopes(Lanes *self, V t, const V *x, V *dx) {
    const V *in[] = {&t, x, self->u, self->c};
    V *out[] = {dx};
    model.rhs(in, out);
}

static M is_finite(const V *values) {
    V sum = every(0);
    for (int i = 0; i < NX; ++i) sum += every(0) * values[i];
    return sum == every(0);
}

static V scale(const Lanes *self, const Batch *batch, int i, V x) {
    return every(batch->absolute) * self->nominal[i] + every(batch->relative) * magnitude(x);
}

static V norm(const Lanes *self, const Batch *batch, const V *values, const V *x) {
    V sum = every(0);
    for (int i = 0; i < NX; ++i) {
        const V ratio = values[i] / scale(self, batch, i, x[i]);
        sum += ratio * ratio;
    }
    return root(sum / every(NX));
}

static V eighth_root(V a) {
    return root(root(root(a)));
}

/* Steps over which the error of order 8 is about the tolerance, from two derivatives. */
static V first_steps(Lanes *self, const Batch *batch, double span) {
    const V size = norm(self, batch, self->x, self->x),
            rate = norm(self, batch, self->k[0], self->x);
    const V least = every(1e-5);
    V h = pick((size > least) & (rate > least), every(0.01) * size / rate, every(1e-6));
    const V shortest = every(LEAST_FIRST * fmax(fabs(batch->grid[0]), span));
    h = smaller(larger(h, shortest), every(span));
    for (int i = 0; i < NX; ++i) self->end[i] = self->x[i] + h * self->k[0][i];
    slopes(self, self->t + h, self->end, self->k[1]);
    for (int i = 0; i < NX; ++i) self->sum[i] = self->k[1][i] - self->k[0][i];
    const V steepest = larger(rate, norm(self, batch, self->sum, self->x) / h);
    const V next = pick(steepest > every(1e-15), eighth_root(every(0.01) / steepest),
                        larger(every(1e-6), every(1e-3) * h));
    const V best = smaller(larger(smaller(every(100) * h, next), shortest), every(span));
    return pick(is_finite(self->k[1]), best, h);
}

/* Whether motions begin as lines in time. */
static M begins_as_line(Lanes *self, const Batch *batch) {
    const V length = every(batch->line);
    M calm = length == length;
    for (int i = 0; i < NX; ++i) self->end[i] = self->x[i] + length * self->k[0][i];
    slopes(self, self->t + length, self->end, self->k[1]);
    for (int i = 0; i < NX; ++i) {
        const V bend = length * magnitude(self->k[1][i] - self->k[0][i]);
        calm &= bend <= every(batch->relative) * magnitude(self->end[i]) +
                            every(batch->few_digits) * self->nominal[i];
    }
    return calm;
}

/* Writes what a run has reached, and frees its lane. */
static void finish(Lanes *self, const Batch *batch, int lane, int code) {
    const long long run = self->run[lane], points = batch->points;
    long long done = self->next[lane];
    double left = self->left[lane], *out = batch->out + run * points * NY;
    V u[NU + 1], c[NC + 1], x[NN + 1], y[NY + 1], t;
    for (int i = 0; i < NU; ++i) u[i] = every(self->u[i][lane]);
    for (int i = 0; i < NC; ++i) c[i] = every(self->c[i][lane]);
    for (long long j = 0; j < done; j += LANES) {
        FOR_LANES t[l] = batch->grid[j + l < done ? j + l : done - 1];
        for (int i = 0; i < NN; ++i)
            memcpy(&x[i], self->kept + (lane * NN + i) * self->stride + j, sizeof x[i]);
        const V *in[] = {&t, x, u, c};
        V *result[] = {y};
        model.observe(in, result);
        for (int l = 0; l < LANES && j + l < done; ++l) {
            double sum = 0;
            for (int i = 0; i < NY; ++i) {
                out[(j + l) * NY + i] = y[i][l];
                sum += 0 * y[i][l];
            }
            if (sum != 0) { /* an output has no value */
                done = j + l;
                code = code ? code : NOT_FINITE;
            }
        }
    }
    if (code == NOT_FINITE && done < points && !(left < batch->grid[done])) left = INFINITY;
    if (left < INFINITY && batch->stop_outside) {
        while (done > 0 && batch->grid[done - 1] >= left) --done;
        code = OUTSIDE;
    }
    for (long long j = done * NY; j < points * NY; ++j) out[j] = NAN;
    double *report = batch->report + run * REPORT;
    report[0] = code;
    report[1] = (double)self->steps[lane];
    report[2] = (double)self->calls[lane];
    report[3] = (double)done;
    report[4] = self->t[lane];
    report[5] = self->spent[lane];
    report[6] = left;
    report[7] = self->limit[lane];
    report[8] = self->calm[lane];
    if (batch->steps) batch->steps[run] = self->planned[lane];
    self->run[lane] = -1;
    self->h[lane] = 0;
}

static void keep(Lanes *self, int lane, const V *x) {
    for (int i = 0; i < NN; ++i)
        self->kept[(lane * NN + i) * self->stride + self->next[lane]] = x[model.needed[i]][lane];
    ++self->next[lane];
    self->trials[lane] = 0;
}

/* Gives runs to idle lanes; returns whether any lane has one. */
static int refill(Lanes *self, const Batch *batch) {
    for (;;) {
        M fresh = {0};
        int some = 0, running = 0;
        FOR_LANES {
            running |= self->run[l] >= 0;
            if (self->run[l] >= 0 || *batch->stop) continue;
            const long long run = __atomic_fetch_add(batch->next, 1, __ATOMIC_RELAXED);
            if (run >= batch->runs) continue;
            for (int i = 0; i < NX; ++i) self->x[i][l] = batch->x0[run * NX + i];
            for (int i = 0; i < NX; ++i) self->nominal[i][l] = batch->nominal[run * NX + i];
            for (int i = 0; i < NU; ++i) self->u[i][l] = batch->u[run * NU + i];
            for (int i = 0; i < NP; ++i) self->p[i][l] = batch->p[run * NP + i];
            self->t[l] = batch->grid[0];
            self->planned[l] = batch->steps ? batch->steps[run] : 0;
            self->run[l] = run;
            self->next[l] = self->trials[l] = self->steps[l] = 0;
            self->calls[l] = 3;
            self->rejected[l] = 0;
            self->spent[l] = 0;
            self->left[l] = INFINITY;
            self->limit[l] = -1;
            self->proven.t[l] = batch->grid[0];
            self->proven.length[l] = 0;
            for (int n = 0; n < NN; ++n) {
                self->proven.low[n][l] = INFINITY;
                self->proven.high[n][l] = -INFINITY;
            }
            fresh[l] = -1;
            some = 1;
            keep(self, l, self->x);
        }
        if (!some) return running;
        const V *in[] = {self->p};
        V *out[] = {self->c};
        model.constants(in, out); /* those of other lanes stay: the same numbers once more */
        if (NL > 0) look_at_start(self, fresh);
        slopes(self, self->t, self->x, self->sum);
        const M good = is_finite(self->sum) & is_finite(self->x);
        for (int i = 0; i < NX; ++i) self->k[0][i] = pick(fresh, self->sum[i], self->k[0][i]);
        const double span = batch->grid[batch->points - 1] - batch->grid[0];
        const V first = smaller(first_steps(self, batch, span), every(batch->largest));
        self->h = pick(fresh, pick(self->planned > 0, self->planned, first), self->h);
        const M calm = begins_as_line(self, batch);
        FOR_LANES if (fresh[l]) self->calm[l] = calm[l] != 0;
        int again = 0;
        FOR_LANES if (fresh[l] && (!good[l] || self->next[l] >= batch->points)) {
            finish(self, batch, l, good[l] ? ENDED : NOT_FINITE);
            again = 1;
        }
        if (!again) return 1;
    }
}

static void stages(Lanes *self) {
    for (int s = 1; s <= END; ++s) {
        model.stage(s, self->k, self->sum);
        for (int i = 0; i < NX; ++i) self->end[i] = self->x[i] + self->h * self->sum[i];
        if (s < END) slopes(self, self->t + every(model.node[s]) * self->h, self->end, self->k[s]);
    }
}

/* Errors of the step in units of the tolerance. */
static V errors(Lanes *self, const Batch *batch) {
    V third[NX], sum_5 = every(0), sum_3 = every(0);
    model.error_5(self->k, self->sum);
    model.error_3(self->k, third);
    for (int i = 0; i < NX; ++i) {
        const V size = larger(magnitude(self->x[i]), magnitude(self->end[i]));
        const V unit = scale(self, batch, i, size), a = self->sum[i] / unit, b = third[i] / unit;
        sum_5 += a * a;
        sum_3 += b * b;
    }
    const V both = sum_5 + every(0.01) * sum_3;
    const V error = magnitude(self->h) * sum_5 / root(every(NX) * both);
    return pick(both > every(0), error, every(0) * both); /* nan stays nan */
}

static void interpolants(Lanes *self) {
    V y[NX];
    for (int s = END + 1; s < EXTENDED; ++s) {
        model.stage(s, self->k, self->sum);
        for (int i = 0; i < NX; ++i) y[i] = self->x[i] + self->h * self->sum[i];
        slopes(self, self->t + every(model.node[s]) * self->h, y, self->k[s]);
    }
    for (int n = 0; n < NN; ++n) {
        const int i = model.needed[n];
        const V change = self->end[i] - self->x[i], bend = self->h * self->k[0][i] - change;
        self->row[0][n] = self->x[i];
        self->row[1][n] = change;
        self->row[2][n] = bend;
        self->row[3][n] = change - self->h * self->k[END][i] - bend;
    }
    for (int j = 0; j < 4; ++j) {
        model.dense(j, self->k, self->sum);
        for (int n = 0; n < NN; ++n) self->row[4 + j][n] = self->h * self->sum[model.needed[n]];
    }
}

/* Keeps a lane's states at the output times within its step, several times at once. */
static void sample(Lanes *self, const Batch *batch, int lane, double after) {
    long long *next = &self->next[lane];
    while (*next < batch->points && batch->grid[*next] < after) {
        V t, x[NN + 1];
        int within = 0;
        FOR_LANES {
            const long long j = *next + l;
            const int inside = j < batch->points && batch->grid[j] < after;
            t[l] = batch->grid[inside ? j : *next];
            within += inside;
        }
        interpolated(self, lane, t, x);
        for (int n = 0; n < NN; ++n)
            memcpy(self->kept + (lane * NN + n) * self->stride + *next, &x[n], sizeof x[n]);
        *next += within;
        self->trials[lane] = 0;
    }
}

/* One step of all lanes. */
static void step(Lanes *self, const Batch *batch) {
    const double stop = batch->grid[batch->points - 1], span = stop - batch->grid[0];
    FOR_LANES {
        if (self->run[l] < 0) continue;
        const double t = self->t[l], h = self->h[l];
        if (*batch->stop)
            finish(self, batch, l, HALTED);
        else if (++self->trials[l] > MOST_TRIALS)
            finish(self, batch, l, TOO_MANY_STEPS);
        else if (!(0.1 * h > fabs(t) * DBL_EPSILON && h >= 1e-18 * span))
            finish(self, batch, l, STEP_TOO_SMALL);
        self->final[l] = t + 1.01 * h >= stop;
        self->planned[l] = h;
    }
    V after = self->t + self->h;
    FOR_LANES if (self->final[l]) after[l] = stop;
    FOR_LANES if (self->run[l] >= 0) self->h[l] = after[l] - self->t[l]; /* as time is rounded */
    stages(self);
    const V error = errors(self, batch);
    slopes(self, after, self->end, self->k[END]);
    M good = (error <= every(1)) & is_finite(self->end) & is_finite(self->k[END]);
    M looks;
    int dense = 0, some = 0;
    FOR_LANES {
        if (self->run[l] < 0)
            good[l] = 0;
        else
            self->calls[l] += STAGES;
        looks[l] = NL > 0 && good[l] && self->left[l] == INFINITY ? -1 : 0;
        some |= looks[l] != 0;
        const int wants = looks[l] || (good[l] && batch->grid[self->next[l]] < after[l]);
        if (wants) self->calls[l] += EXTENDED - STAGES - 1;
        dense |= wants;
    }
    if (dense) interpolants(self);
    if (some && NB > 0) look_by_bounds(self, looks, after);
    if (some && NB < NL) look(self, looks, after);
    const V change = every(0.9) / eighth_root(error), least = every(1.0 / 3);
    V growth = larger(change, least);
    FOR_LANES {
        if (self->run[l] < 0) continue;
        const double most = error[l] > 1 || self->rejected[l] ? 1.0 : 6.0;
        growth[l] = growth[l] < most ? growth[l] : most;
        if (!good[l] && !(error[l] > 1)) growth[l] = 0.1;
        self->rejected[l] = !good[l];
        if (!good[l]) continue;
        ++self->steps[l];
        self->spent[l] += error[l];
        sample(self, batch, l, after[l]);
        if (self->next[l] < batch->points && batch->grid[self->next[l]] <= after[l])
            keep(self, l, self->end);
    }
    for (int i = 0; i < NX; ++i) {
        self->x[i] = pick(good, self->end[i], self->x[i]);
        self->k[0][i] = pick(good, self->k[END][i], self->k[0][i]);
    }
    self->t = pick(good, after, self->t);
    self->h = smaller(self->h * growth, every(batch->largest));
    self->planned = pick(good, larger(self->planned, self->h), self->h);
    FOR_LANES {
        const int left = batch->stop_outside && self->left[l] < INFINITY;
        if (self->run[l] >= 0 && (left || self->next[l] >= batch->points))
            finish(self, batch, l, ENDED);
    }
}

/* Runs what is left of a batch; several threads may do so. Returns 0 unless memory is short. */
LANES_SHARED int lanes_run(const Batch *batch) {
    const long long stride = batch->points + LANES;
    char *memory = calloc(1, sizeof(Lanes) + 64);
    double *kept = calloc((size_t)(stride * LANES * (NN + 1)), sizeof *kept);
    if (memory && kept) {
        Lanes *self = (Lanes *)(memory + (64 - (uintptr_t)memory % 64));
        self->kept = kept;
        self->stride = stride;
        FOR_LANES self->run[l] = -1;
        while (refill(self, batch)) step(self, batch);
    }
    const int failed = !memory || !kept;
    free(memory);
    free(kept);
    return failed;
}

#endif
