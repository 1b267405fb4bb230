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

#include "lanes.h"

/* States, inputs, parameters, constants (what depends on parameters alone), states that outputs
 * need, outputs, limits, and how many of these have bounds; no relation switches: MODES is 0. */
#if !defined NX || !defined NU || !defined NP || !defined NC || !defined NN || !defined NY ||      \
    !defined NL || !defined NB || !defined MODES
#error "define NX, NU, NP, NC, NN, NY, NL, NB and MODES before solvers are included"
#endif

#include "margins.h"

enum { STAGES = 12, END = STAGES, EXTENDED = 16, REPORT = 9 };
enum { ENDED, TOO_MANY_STEPS, STEP_TOO_SMALL, INCONSISTENT, NOT_FINITE, HALTED, OUTSIDE };

#define MOST_TRIALS 100000 /* per output interval */

typedef void LaneSum(V (*k)[NX], V *sum);
typedef void LaneRow(int row, V (*k)[NX], V *sum);

/* A model and the method's coefficients as straight-line code; generated code fills it. */
typedef struct {
    LaneFunction *constants; /* p -> c */
    LaneFunction *rhs;       /* t, x, u, c -> dx/dt */
    LaneFunction *observe;   /* t, needed states, u, c -> outputs */
    LaneFunction *margins;   /* the same -> margins of the limits; NULL without limits */
    LaneFunction *bounds; /* t, length, least and greatest needed states, and rates of these, u, c
                             -> lower bounds of margins over the length from t on */
    LaneFunction *rates;  /* the same -> bounds of the rates of these margins */
    const int *bounded;   /* the limits that these are of, NB of them */
    const int *moving;    /* states, among those that are needed, that move these bounds; -1 */
    const int *needed;
    const double *node;
    LaneRow *stage, *dense;
    LaneSum *error_5, *error_3;
} LaneModel;

static const LaneModel model;

/* What is to be run; arrays by run, then by time. Threads share one batch. */
typedef struct {
    long long runs, points;
    const double *x0, *nominal, *u, *p, *grid; /* the grid begins with the start time */
    double relative, absolute, largest;        /* step */
    double *out, *report;                      /* NaN beyond the last good time */
    long long *next;                           /* run to begin next */
    const volatile int *stop;
    long long stop_outside; /* whether a run ends where it leaves the limits */
    double *steps;          /* step sizes that runs begin with, 0 for none, and end with; or NULL */
} Batch;

/* Between which values states, and their rates, stay over a length from t on. */
typedef struct {
    V t, length, low[NN + 1], high[NN + 1], slowest[NN + 1], fastest[NN + 1];
} Part;

typedef struct {
    V t, h, c[NC + 1], u[NU + 1], p[NP + 1], nominal[NX], x[NX], end[NX], sum[NX], k[EXTENDED][NX];
    V planned;         /* steps that the end does not cut off */
    V row[8][NN + 1];  /* of the interpolants, in Hairer's nested form */
    V margins[NL + 1]; /* at t, while no limit has been left */
    Part proven;       /* within it, bounds have proven that limits hold */
    long long run[LANES], next[LANES], trials[LANES], steps[LANES], calls[LANES];
    int rejected[LANES], final[LANES];
    double spent[LANES], left[LANES]; /* when a limit was left first; infinite: never */
    double straight[LANES];           /* until when the motion from the start is a line in time */
    int limit[LANES];
    double *kept; /* needed states by lane, state and time */
    long long stride;
} Lanes;

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
    h = smaller(h, every(span));
    for (int i = 0; i < NX; ++i) self->end[i] = self->x[i] + h * self->k[0][i];
    slopes(self, self->t + h, self->end, self->k[1]);
    for (int i = 0; i < NX; ++i) self->sum[i] = self->k[1][i] - self->k[0][i];
    const V steepest = larger(rate, norm(self, batch, self->sum, self->x) / h);
    const V next = pick(steepest > every(1e-15), eighth_root(every(0.01) / steepest),
                        larger(every(1e-6), every(1e-3) * h));
    const V best = smaller(smaller(every(100) * h, next), every(span));
    return pick(is_finite(self->k[1]), best, h);
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
    report[8] = self->straight[lane];
    if (batch->steps) batch->steps[run] = self->planned[lane];
    self->run[lane] = -1;
    self->h[lane] = 0;
}

/* States that outputs and margins need, within the step of one lane. */
static void interpolated(const Lanes *self, int lane, V t, V *x) {
    const V s = (t - every(self->t[lane])) / every(self->h[lane]), r = every(1) - s;
    for (int n = 0; n < NN; ++n) {
        x[n] = every(self->row[7][n][lane]);
        for (int j = 6; j >= 0; --j) x[n] = every(self->row[j][n][lane]) + (j % 2 ? r : s) * x[n];
    }
}

/* The margins of all lanes, each at a time of its own. */
static void all_margins(const Lanes *self, V t, const V *x, V *margins) {
    const V *in[] = {&t, x, self->u, self->c};
    V *out[] = {margins};
    model.margins(in, out);
}

/* A limit of a lane within its step. */
typedef struct {
    const Lanes *lanes;
    int lane, limit;
} Margin;

static void look_at_limit(void *margin, double t, Place *found) {
    const Margin *self = margin;
    V x[NN + 1], margins[NL + 1];
    interpolated(self->lanes, self->lane, every(t), x);
    all_margins(self->lanes, every(t), x, margins);
    note_no_event(t, found);
    const double own = margins[self->limit][self->lane];
    found->inside[0] = own > 0 ? own : -DBL_MIN;
}

static void call_bounds(LaneFunction *bounds, const Part *part, const V *u, const V *c, V *low,
                        V *high) {
    const V *in[] = {&part->t,      &part->length, part->low, part->high,
                     part->slowest, part->fastest, u,         c};
    V *out[] = {low, high};
    bounds(in, out);
}

/* Whether bounds prove that a limit of a lane holds between two times. */
static bool holds_between(void *margin, const Place *a, const Place *b) {
    const Margin *self = margin;
    const Lanes *lanes = self->lanes;
    const double length = b->t - a->t;
    double values[NN + 1][NODES];
    V t, x[NN + 1], u[NU + 1], c[NC + 1], lows[NB + 1], slowest[NB + 1], fastest[NB + 1];
    Part part = {.t = every(a->t), .length = every(length)};
    int k = 0;
    while (model.bounded[k] != self->limit) ++k;
    for (int j = 0; j < NODES; j += LANES) {
        FOR_LANES t[l] = node_between(a->t, b->t, j + l < NODES ? j + l : NODES - 1);
        interpolated(lanes, self->lane, t, x);
        for (int l = 0; l < LANES && j + l < NODES; ++l)
            for (int n = 0; n < NN; ++n) values[n][j + l] = x[n][l];
    }
    for (const int *n = model.moving; *n >= 0; ++n) {
        const Span span = span_of(values[*n], length);
        part.low[*n] = every(span.low);
        part.high[*n] = every(span.high);
        part.slowest[*n] = every(span.slowest);
        part.fastest[*n] = every(span.fastest);
    }
    for (int i = 0; i < NU; ++i) u[i] = every(lanes->u[i][self->lane]);
    for (int i = 0; i < NC; ++i) c[i] = every(lanes->c[i][self->lane]);
    call_bounds(model.bounds, &part, u, c, lows, NULL);
    if (lows[k][0] >= 0) return true;
    call_bounds(model.rates, &part, u, c, slowest, fastest);
    const Spanned span = {lows[k][0], slowest[k][0], fastest[k][0]};
    return stays_positive(&span, a->inside[0], b->inside[0], length);
}

/* The lanes in whose steps bounds prove that all limits that have them hold: in the box of states
 * in which they have been proven to, that box made wider, or that of the step. Each factor of the
 * nested form is from 0 to 1. */
static M hold_in_box(Lanes *self, M some, V after) {
    Part *proven = &self->proven, box;
    V low[NN + 1], high[NN + 1], lows[NB + 1];
    M open = ~(after <= proven->t + proven->length);
    for (const int *n = model.moving; *n >= 0; ++n) {
        low[*n] = high[*n] = self->row[7][*n];
        for (int j = 6; j >= 0; --j) {
            low[*n] = self->row[j][*n] + smaller(low[*n], every(0));
            high[*n] = self->row[j][*n] + larger(high[*n], every(0));
        }
        open |= ~((low[*n] >= proven->low[*n]) & (high[*n] <= proven->high[*n]));
    }
    open &= some;
    for (int trial = 0; trial < 2 && any(open); ++trial) {
        box.t = trial ? self->t : proven->t;
        box.length = LIMITS_OF_TIME ? every(2) * (after - box.t) : every(INFINITY);
        for (const int *n = model.moving; *n >= 0; ++n) {
            const V least = trial ? low[*n] : smaller(low[*n], proven->low[*n]);
            const V most = trial ? high[*n] : larger(high[*n], proven->high[*n]);
            const V more = every(trial ? 0 : WIDER) * (most - least);
            box.low[*n] = least - more;
            box.high[*n] = most + more;
        }
        call_bounds(model.bounds, &box, self->u, self->c, lows, NULL);
        M holds = open;
        for (int k = 0; k < NB; ++k) holds &= lows[k] >= every(0);
        open &= ~holds;
        proven->t = pick(holds, box.t, proven->t);
        proven->length = pick(holds, box.length, proven->length);
        for (const int *n = model.moving; *n >= 0; ++n) {
            proven->low[*n] = pick(holds, box.low[*n], proven->low[*n]);
            proven->high[*n] = pick(holds, box.high[*n], proven->high[*n]);
        }
    }
    return some & ~open;
}

static void note_left(Lanes *self, int lane, int limit, double time) {
    if (!(time < self->left[lane])) return;
    self->left[lane] = time;
    self->limit[lane] = limit;
}

/* Notes the limits with bounds that some lanes leave first in their steps. */
static void look_by_bounds(Lanes *self, M some, V after) {
    const M open = some & ~hold_in_box(self, some, after);
    FOR_LANES for (int k = 0; k < NB && open[l]; ++k) {
        Margin margin = {self, l, model.bounded[k]};
        note_left(self, l, margin.limit,
                  first_crossing(look_at_limit, holds_between, &margin, self->t[l], after[l]));
    }
}

static int has_bounds(int limit) {
    for (int k = 0; k < NB; ++k)
        if (model.bounded[k] == limit) return 1;
    return 0;
}

/* Notes the other limits that some lanes leave first in their steps. */
static void look(Lanes *self, M some, V after) {
    V x[NN + 1], margins[LOOKS + 1][NL + 1];
    memcpy(margins[0], self->margins, sizeof margins[0]);
    for (int k = 1; k <= LOOKS; ++k) {
        const V s = every((double)k / LOOKS), r = every(1) - s;
        for (int n = 0; n < NN; ++n) {
            x[n] = self->row[7][n];
            for (int j = 6; j >= 0; --j) x[n] = self->row[j][n] + (j % 2 ? r : s) * x[n];
        }
        all_margins(self, self->t + s * (after - self->t), x, margins[k]);
    }
    FOR_LANES for (int i = 0; i < NL && some[l]; ++i) {
        Margin margin = {self, l, i};
        double known[LOOKS + 1];
        if (has_bounds(i)) continue;
        for (int k = 0; k <= LOOKS; ++k) known[k] = margins[k][i][l];
        note_left(self, l, i, first_outside(look_at_limit, &margin, self->t[l], after[l], known));
    }
    for (int i = 0; i < NL; ++i) self->margins[i] = pick(some, margins[LOOKS][i], self->margins[i]);
}

/* Notes the margins of the first states of some lanes. */
static void look_at_start(Lanes *self, M some) {
    V x[NN + 1], margins[NL + 1];
    for (int n = 0; n < NN; ++n) x[n] = self->x[model.needed[n]];
    all_margins(self, self->t, x, margins);
    for (int i = 0; i < NL; ++i) self->margins[i] = pick(some, margins[i], self->margins[i]);
    FOR_LANES for (int i = 0; i < NL && some[l]; ++i) if (!(margins[i][l] > 0))
        note_left(self, l, i, self->t[l]);
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
            self->calls[l] = 2;
            self->rejected[l] = 0;
            self->spent[l] = 0;
            self->straight[l] = batch->grid[0];
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
        model.constants(in,
                        out); /* the other lanes' stay as they are: the same numbers once more */
        if (NL > 0) look_at_start(self, fresh);
        slopes(self, self->t, self->x, self->sum);
        const M good = is_finite(self->sum) & is_finite(self->x);
        for (int i = 0; i < NX; ++i) self->k[0][i] = pick(fresh, self->sum[i], self->k[0][i]);
        const double span = batch->grid[batch->points - 1] - batch->grid[0];
        const V first = smaller(first_steps(self, batch, span), every(batch->largest));
        self->h = pick(fresh, pick(self->planned > 0, self->planned, first), self->h);
        int again = 0;
        FOR_LANES if (fresh[l] && (!good[l] || self->next[l] >= batch->points)) {
            if (!good[l]) self->next[l] = 0;
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

/* Notes the lanes whose motion, a line in time from the start, goes on as one to the tolerance. */
static void note_straight(Lanes *self, const Batch *batch, M good, V after) {
    int some = 0;
    FOR_LANES some |= good[l] && self->straight[l] == self->t[l];
    if (!some) return;
    for (int i = 0; i < NX; ++i) self->sum[i] = self->h * (self->k[END][i] - self->k[0][i]);
    const V bend = norm(self, batch, self->sum, self->x);
    FOR_LANES {
        const int follows = good[l] && self->straight[l] == self->t[l];
        if (follows && bend[l] <= 1) self->straight[l] = after[l];
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
        if (self->final[l] && self->run[l] >= 0) self->h[l] = stop - t;
    }
    stages(self);
    V after = self->t + self->h;
    FOR_LANES if (self->final[l]) after[l] = stop;
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
    note_straight(self, batch, good, after);
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
