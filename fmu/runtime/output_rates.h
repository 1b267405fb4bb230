/* Time derivatives of outputs along the solution, up to order 3, with inputs that move as declared.

   The first one is exact. The others are differences of fourth order of the first ones, at states a
   small part of a step before and after the present one, and ever nearer to it, as outputs may vary
   faster than states, until rounding counts. Where it counts at once, as steps are short at a rest,
   they begin farther away. */
#ifndef OUTPUT_RATES_H
#define OUTPUT_RATES_H

#include <float.h>
#include <math.h>
#include <string.h>

#include "evaluation.h"
#include "input_motion.h"
#include "integration.h"
#include "logging.h"
#include "sensitivity.h"
#include "stepping.h"

enum { MOST_ORDER = 3, TIMES = 5, HERE = 2 };

static const double PART = 0.01;  /* of a step, between two points at first */
static const double FINER = 4;    /* how much nearer they come each time, ... */
static const double LESS = 255;   /* ... which makes errors of fourth order smaller by 4^4 */
static const double ROUNDED = 16; /* roundings of a rate */
static const double FARTHER = 64, INEXACT = 1e-5; /* a beginning after one with such an error */

static Status check_orders(Instance *self, size_t count, const Order orders[], int *highest) {
    if (!orders) return refuse(self, ERROR, "the orders are missing");
    for (size_t i = 0; i < count; i++) {
        if (orders[i] < 1 || orders[i] > MOST_ORDER)
            return refuse(self, ERROR, "derivatives have orders 1 to %d, not %d", MOST_ORDER,
                          (int)orders[i]);
        if (orders[i] > *highest) *highest = orders[i];
    }
    return OK;
}

/* dx/dt at a state and a time after that of `from`, which the instance then has. */
static Status slope_at(Instance *self, const State *from, double since, const double x[],
                       double dx[]) {
    self->state = *from;
    move_inputs(self, from->values[TIME] + since);
    memcpy(self->state.values + FIRST_STATE, x, NX * sizeof *x);
    self->state.stale |= AFTER_START;
    const Status status = refresh(self, DERIVATIVES);
    memcpy(dx, self->state.values + FIRST_DERIVATIVE, NX * sizeof *dx);
    return status;
}

/* Move the instance along the solution by the classical Runge-Kutta method. */
static Status move_by(Instance *self, const State *from, double since) {
    const double *begin = from->values + FIRST_STATE;
    const double shares[] = {0, 0.5, 0.5, 1}, weights[] = {1, 2, 2, 1};
    double x[ROOM(NX)], dx[ROOM(NX)] = {0}, sum[ROOM(NX)] = {0};
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < NX; i++) x[i] = begin[i] + shares[stage] * since * dx[i];
        const Status status = slope_at(self, from, shares[stage] * since, x, dx);
        if (status != OK) return status;
        for (int i = 0; i < NX; i++) sum[i] += weights[stage] * dx[i];
    }
    for (int i = 0; i < NX; i++) x[i] = begin[i] + since / 6 * sum[i];
    return slope_at(self, from, since, x, dx);
}

static double difference(int order, double h, double rates[TIMES][N_VARIABLES], uint32_t k) {
    const double near = rates[HERE + 1][k], far = rates[HERE + 2][k];
    const double near_before = rates[HERE - 1][k], far_before = rates[HERE - 2][k];
    if (order == 2) return (8 * (near - near_before) - (far - far_before)) / (12 * h);
    return (16 * (near + near_before) - (far + far_before) - 30 * rates[HERE][k]) / (12 * h * h);
}

/* What rounding of rates up to a size makes of a difference. */
static double rounding_of(int order, double h, double size) {
    return ROUNDED * DBL_EPSILON * size / (order == 2 ? h : h * h);
}

/* The best derivatives so far, the last ones, and what the best may be off by; a row per order. */
typedef struct {
    double best[MOST_ORDER + 1][N_VARIABLES], last[MOST_ORDER + 1][N_VARIABLES];
    double errors[MOST_ORDER + 1][N_VARIABLES], sizes[N_VARIABLES];
} Differences;

/* Take differences over another distance, where they change least. */
static void compare(Differences *self, double h, double rates[TIMES][N_VARIABLES], bool first) {
    for (uint32_t k = 0; k < N_VARIABLES; k++) {
        self->sizes[k] = 0;
        for (int i = 0; i < TIMES; i++) self->sizes[k] = fmax(self->sizes[k], fabs(rates[i][k]));
        for (int order = 2; order <= MOST_ORDER; order++) {
            const double now = difference(order, h, rates, k);
            const double change = fabs(now - self->last[order][k]);
            const double error = change / LESS + rounding_of(order, h, self->sizes[k]);
            double *least = &self->errors[order][k];
            if (!first && *least == INFINITY)
                *least = change + rounding_of(order, h * FINER, self->sizes[k]);
            if (first ? *least == INFINITY : !(*least <= error)) {
                self->best[order][k] = now;
                *least = first ? INFINITY : error;
            }
            self->last[order][k] = now;
        }
    }
}

/* What is asked for. */
typedef struct {
    const Reference *references;
    const Order *orders;
    size_t count;
} Wanted;

/* Whether distances that are smaller, or begin farther away, may give better derivatives. */
typedef struct {
    bool smaller, farther;
} Prospects;

static Prospects prospects(const Differences *found, const Wanted *wanted, double h) {
    Prospects ahead = {false, false};
    for (size_t i = 0; i < wanted->count; i++) {
        const Reference k = wanted->references[i];
        const int order = wanted->orders[i];
        const double error = found->errors[order][k], size = found->sizes[k];
        const double value = fabs(found->best[order][k]);
        if (order < 2) continue;
        ahead.smaller |= error > rounding_of(order, h / FINER, size);
        ahead.farther |= error > INEXACT * fmax(value, size / pow(LARGEST_STEP, order - 1));
    }
    return ahead;
}

/* Rates at points around a state, which the instance then has again. */
static Status rates_around(Instance *self, const State *from, double h,
                           double rates[TIMES][N_VARIABLES]) {
    Status status = OK;
    for (int k = 0; k < TIMES && status == OK; k++) {
        if (k != HERE) status = move_by(self, from, (k - HERE) * h);
        if (status == OK) status = all_rates(self, rates[k]);
        self->state = *from;
    }
    return status;
}

/* Take differences over a distance and ever smaller ones, until rounding counts. */
static Status one_sweep(Instance *self, const State *from, const Wanted *wanted, double begin,
                        double shortest, Differences *found, Prospects *ahead) {
    double rates[TIMES][N_VARIABLES];
    double h = begin;
    do {
        const Status status = rates_around(self, from, h, rates);
        if (status != OK) return status;
        compare(found, h, rates, h == begin);
        *ahead = prospects(found, wanted, h);
        h /= FINER;
    } while (ahead->smaller && h >= shortest);
    return OK;
}

static Status higher_rates(Instance *self, const Wanted *wanted, double values[]) {
    Differences found = {.sizes = {0}};
    Prospects ahead = {.farther = true};
    const State from = self->state;
    const double shortest = 2 * DBL_EPSILON * fabs(from.values[TIME]);
    int exponent; /* of a power of two, over which times and halves between them are not rounded */
    frexp(fmax(PART * typical_step(self), shortest), &exponent);
    const double nearest = ldexp(1, exponent), farthest = fmax(nearest, PART * LARGEST_STEP);
    for (uint32_t k = 0; k < N_VARIABLES; k++) found.errors[2][k] = found.errors[3][k] = INFINITY;
    for (double begin = nearest; ahead.farther && begin <= farthest; begin *= FARTHER) {
        const Status status = one_sweep(self, &from, wanted, begin, shortest, &found, &ahead);
        if (status != OK && begin == nearest) return status;
        if (status != OK) break;
    }
    for (size_t i = 0; i < wanted->count; i++)
        if (wanted->orders[i] > 1) values[i] = found.best[wanted->orders[i]][wanted->references[i]];
    if (all_finite(values, (int)wanted->count)) return OK;
    return refuse(self, DISCARD, "a derivative is not finite");
}

static Status get_rates(Instance *self, const Reference references[], size_t count,
                        const Order orders[], double values[]) {
    const Wanted wanted = {references, orders, count};
    const bool asks = self->host.ask_inputs != NULL;
    double motion[MOST_INPUT_ORDER][ROOM(NU)];
    int highest = 0;
    if (count == 0) return OK;
    if (check_orders(self, count, orders, &highest) != OK) return ERROR;
    /* who is asked for inputs declares none of their rates: those of the last step, which what
       waits or slides still needs, are not those that come */
    memcpy(motion, self->state.motion, sizeof motion);
    if (asks) forget_motion(self);
    Status status = time_derivatives(self, references, count, values);
    if (status == OK && highest > 1) status = higher_rates(self, &wanted, values);
    memcpy(self->state.motion, motion, sizeof motion);
    if (asks && is_sliding_now(self)) self->state.stale |= AFTER_START; /* modes follow from both */
    return status;
}

#endif
