/* The steps of many runs, a run in each lane, and when these leave the limits of a model. */
#ifndef LANES_LIMITS_H
#define LANES_LIMITS_H

#include <float.h>

#include "lanes.h"

/* States, inputs, parameters, constants (what depends on parameters alone), states that outputs
 * need, outputs, limits, and how many of these have bounds; no relation switches: MODES is 0. */
#if !defined NX || !defined NU || !defined NP || !defined NC || !defined NN || !defined NY ||      \
    !defined NL || !defined NB || !defined MODES
#error "define NX, NU, NP, NC, NN, NY, NL, NB and MODES before solvers are included"
#endif

#include "margins.h"

enum { STAGES = 12, END = STAGES, EXTENDED = 16 };

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
    int rejected[LANES], final[LANES], calm[LANES];
    double spent[LANES], left[LANES]; /* when a limit was left first; infinite: never */
    int limit[LANES];
    double *kept; /* needed states by lane, state and time */
    long long stride;
} Lanes;

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

#endif
