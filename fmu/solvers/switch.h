/* Events of the states within a run: modes, assignments, and what these make happen at the same
 * instant. Where a relation slides or rests, or a run ends, the caller has to go on.
 *
 * evaluate(t, x, z, u, c) -> (arguments and rates of the relations, sizes of these rates,
 * conditions, assigned values, violation of the invariants, z), z from its guess.
 */
#ifndef SWITCH_H
#define SWITCH_H

#include <float.h>

#include "watch.h"

#if !defined MODES || !defined EVENTS || !defined ASSIGNED
#error "define MODES, EVENTS and ASSIGNED: how many modes, conditions and assignments there are"
#endif

enum { MOST_ROUNDS = 100, RECORD = 1 + 2 * NX + 2 * NZ + 4 * MODES + EVENTS };

static const double SWITCH_ROUNDING = 64 * DBL_EPSILON; /* relative size of a rate that is 0 */

/* What happens when a condition becomes true. */
typedef struct {
    int count; /* of assignments, in the order of all */
    int sampled, ends;
} Rule;

/* Generated code fills it; `evaluate` is NULL where the caller is asked at every event. */
typedef struct {
    Equations *evaluate;
    const int *watched; /* the mode of each relation that is watched */
    const int *floors;
    const Rule *rules;
    const int *assigned; /* states */
} Switches;

static const Switches switches;

typedef struct {
    double arguments[MODES + 1], rates[MODES + 1], sizes[MODES + 1];
    double conditions[EVENTS + 1], values[ASSIGNED + 1], defect, z[NZ + 1];
} Decision;

static inline int decision_at(Problem *self, double t, const double *x, Decision *found) {
    self->arg[0] = &t;
    self->arg[1] = x;
    self->arg[2] = self->z;
    self->arg[3] = self->u;
    self->arg[4] = self->c;
    self->res[0] = found->arguments;
    self->res[1] = found->rates;
    self->res[2] = found->sizes;
    self->res[3] = found->conditions;
    self->res[4] = found->values;
    self->res[5] = &found->defect;
    self->res[6] = found->z;
    return switches.evaluate(self->arg, self->res, self->iw, self->w, 0);
}

/* The mode that value and rate require. Returns 0 unless higher derivatives decide. */
static inline int required(const Decision *at, int i, double *mode, int *zero) {
    const double value = at->arguments[i], boundary = switches.floors[i] ? nearbyint(value) : 0;
    if (!isfinite(value)) return 0; /* of a branch that is not taken */
    if (!*zero && value != boundary) {
        *mode = switches.floors[i] ? floor(value) : value > 0 ? 1 : -1;
        return 0;
    }
    *zero = 1;
    const double tiny = SWITCH_ROUNDING * at->sizes[i];
    const int up = at->rates[i] > 0;
    if (!(fabs(at->rates[i]) > tiny)) return 1;
    *mode = switches.floors[i] ? boundary - !up : up ? 1 : -1;
    return 0;
}

/* Modes that are consistent with what follows; `zero` tells which arguments are 0. Returns 0 where
 * they are found. */
static inline int settle(Problem *self, double t, const double *x, const int *zero,
                         Decision *found) {
    double *modes = self->u + NU - MODES;
    for (int trial = 0; trial < MOST_ROUNDS; ++trial) {
        int changed = 0;
        if (decision_at(self, t, x, found)) return 1;
        for (int i = 0; i < MODES && !changed; ++i) {
            double mode = modes[i], back;
            int at_zero = zero[i];
            if (required(found, i, &mode, &at_zero)) return 1;
            if (mode == modes[i]) continue;
            modes[i] = back = mode;
            changed = 1;
            if (!at_zero || switches.floors[i]) continue;
            Decision other = {{0}, {0}, {0}, {0}, {0}, 0, {0}};
            if (decision_at(self, t, x, &other) || required(&other, i, &back, &at_zero) ||
                back != mode)
                return 1; /* it slides */
        }
        if (!changed) return 0;
    }
    return 1;
}

/* Assigns the new values of events that have risen. Returns 0 where the run can go on. */
static inline int assign(Problem *self, double t, double *x, const Decision *at, const int *risen,
                         int *zero) {
    Decision after = {{0}, {0}, {0}, {0}, {0}, 0, {0}};
    int given[NX] = {0};
    for (int i = 0, k = 0; i < EVENTS; k += switches.rules[i++].count)
        for (int j = k; risen[i] && j < k + switches.rules[i].count; ++j) {
            const int state = switches.assigned[j];
            if (given[state] && x[state] != at->values[j]) return 1;
            given[state] = 1;
            x[state] = at->values[j];
        }
    if (!is_finite(x) || decision_at(self, t, x, &after)) return 1;
    for (int i = 0; i < MODES; ++i) zero[i] = zero[i] && after.arguments[i] == at->arguments[i];
    return after.defect > 1e-6 && after.defect > 10 * at->defect;
}

/* All that happens at an instant; `order` tells which events happen one after the other. */
static inline int iterate(Problem *self, double t, double *x, int *zero, double *order,
                          Decision *at) {
    double before[EVENTS + 1];
    int risen[EVENTS + 1], happened = 0;
    memcpy(before, at->conditions, sizeof before);
    if (settle(self, t, x, zero, at)) return 1;
    for (int round = 0; round < MOST_ROUNDS; ++round) {
        int any = 0;
        for (int i = 0; i < EVENTS; ++i) {
            const double now = at->conditions[i];
            risen[i] = now > before[i] && !(switches.rules[i].sampled && now < 0);
            if (!risen[i]) continue;
            if (switches.rules[i].ends || order[i] > 0) return 1;
            order[i] = ++happened;
            any = 1;
        }
        if (!any) return 0;
        memcpy(before, at->conditions, sizeof before);
        if (assign(self, t, x, at, risen, zero) || settle(self, t, x, zero, at)) return 1;
    }
    return 1;
}

static inline void append(double **end, const double *values, int count) {
    memcpy(*end, values, (size_t)count * sizeof **end);
    *end += count;
}

static inline void append_flags(double **end, const int *flags, int count) {
    for (int i = 0; i < count; ++i) *(*end)++ = flags[i];
}

/* Goes through the event at a crossing: x becomes the state after it, and what was before and after
 * is recorded. Returns 0 where the run goes on from there; otherwise all is as before. */
static inline int pass_event(Problem *self, const Crossing *crossing, double *x) {
    double *modes = self->u + NU - MODES, before[MODES + 1], dx[NX], state[NX], order[EVENTS + 1];
    int zero[MODES + 1] = {0}, zero_before[MODES + 1];
    const double t = crossing->time;
    Decision at = {{0}, {0}, {0}, {0}, {0}, 0, {0}};
    Place place;
    if (!switches.evaluate || self->records == self->last_record) return 1;
    if (look_afresh(self, t, x, dx, &place) || decision_at(self, t, x, &at)) return 1;
    for (int i = 0; i < RELATIONS; ++i) {
        const double near = 8 * DBL_EPSILON * fabs(t) * fabs(place.rates[i]);
        zero[switches.watched[i]] =
            i == crossing->relation || (place.rates[i] < 0 && fabs(place.inside[i]) <= near);
    }
    double *end = self->records;
    memset(order, 0, sizeof order);
    memcpy(before, modes, sizeof before - sizeof *before);
    memcpy(state, x, sizeof state);
    memcpy(zero_before, zero, sizeof zero);
    append(&end, &t, 1);
    append(&end, x, NX);
    append(&end, at.z, NZ);
    if (iterate(self, t, x, zero, order, &at)) {
        memcpy(modes, before, sizeof before - sizeof *before);
        memcpy(x, state, sizeof state);
        return 1;
    }
    append(&end, before, MODES);
    append_flags(&end, zero_before, MODES);
    append(&end, x, NX);
    append(&end, at.z, NZ);
    append(&end, modes, MODES);
    append_flags(&end, zero, MODES);
    append(&end, order, EVENTS);
    self->records = end;
    memcpy(self->z, at.z, NZ * sizeof *at.z);
    self->looked_at = 0;
    for (int i = 0; i < RELATIONS; ++i) {
        const int mode = switches.watched[i];
        self->stays[i] = zero[mode] ? 0 : -1; /* it moves */
        self->offsets[i] = 0;
    }
    return 0;
}

#endif
