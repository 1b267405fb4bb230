/* Inputs that leap at one instant, as those do that an importer holds within its steps. No step
   meets what the equations do for values in between: a warning tells of short changes there. */
#ifndef LEAPS_H
#define LEAPS_H

#include "evaluation.h"
#include "modes.h"

#if HAS_LEAPS

#include <float.h>
#include <math.h>
#include <string.h>

/* Places divide a change of a term into parts of an eighth: a step that stays has nine. Two leaps
   that pass no more of them resolve it, or meet the values at both its ends. */
enum { MOST_PLACES = 9, RESULTS = NX + NY - N_WATCHED, INPUTS = NU - MODES };

static bool is_sign(int relation) {
    return !relation_table[relation].of_time && !relation_table[relation].floor;
}

/* Replace inputs by those at a share of the way from others to them. */
static void go_on_way(const double from[], double share, double u[]) {
    for (int i = 0; i < INPUTS; i++) u[i] = from[i] + share * (u[i] - from[i]);
}

/* Derivatives, outputs and then modes with inputs at a share of the way to the present ones. False
   where they have no values. */
static bool results_on_way(Instance *self, const double from[], double share, double found[]) {
    const State kept = self->state;
    const uint32_t logged = self->categories;
    const Laws laws = laws_of(self);
    const Point at = present(self);
    double before[ROOM(MODES)];
    self->categories = 0;
    go_on_way(from, share, at.u);
    self->state.stale = (self->state.stale | AFTER_START) & ~(uint32_t)SIDES;
    for (int n = 0; n < MODES; n++) { /* arguments may hold other modes */
        memcpy(before, modes_of(&at), MODES * sizeof *before);
        guess_modes(&laws, &at, MODES);
        if (memcmp(before, modes_of(&at), MODES * sizeof *before) == 0) break;
    }
    const bool known = refresh(self, DERIVATIVES | OUTPUTS) == OK;
    memcpy(found, self->state.values + FIRST_DERIVATIVE, NX * sizeof *found);
    memcpy(found + NX, self->state.values + FIRST_OUTPUT, (RESULTS - NX) * sizeof *found);
    memcpy(found + RESULTS, modes_of(&at), MODES * sizeof *found);
    self->state = kept;
    self->categories = logged;
    return known;
}

/* Whether results leave those at both ends by more than these differ, where relations switch on
   the way: two of them, or one that switches back. `shares`: where they do; negative: nowhere. */
static bool results_return(Instance *self, const double from[], const double shares[]) {
    double a[RESULTS + MODES], b[RESULTS + MODES], c[RESULTS + MODES];
    if (!results_on_way(self, from, 0, a) || !results_on_way(self, from, 1, b)) return false;
    for (int i = 0; i < MODES; i++) {
        if (!(shares[i] >= 0)) continue;
        double next = 1;
        for (int k = 0; k < MODES; k++)
            if (shares[k] > shares[i] + LOCATED) next = fmin(next, shares[k]);
        for (int half = 0; half < 2; half++) {
            const double share = shares[i] + half * (next - shares[i]) / 2;
            if (!results_on_way(self, from, share, c)) continue;
            bool returns = next < 1, is_out = false;
            for (int k = RESULTS; k < RESULTS + MODES; k++) returns |= a[k] == b[k] && c[k] != a[k];
            for (int k = 0; k < RESULTS; k++) {
                const double rounding = 64 * DBL_EPSILON * fmax(fabs(a[k]), fabs(b[k]));
                const double beyond = fmax(c[k] - fmax(a[k], b[k]), fmin(a[k], b[k]) - c[k]);
                is_out |= beyond > fabs(a[k] - b[k]) + rounding;
            }
            if (returns && is_out) return true;
        }
    }
    return false;
}

/* Where an argument that has values at both ends and in the middle changes its sign, as a share of
   the way; if it does so twice, the place between. Negative: nowhere. Exact for parabolas. */
static double share_of_change(double a, double middle, double b) {
    if (a * b < 0) return a / (a - b);
    const double rise = 4 * middle - 3 * a - b, bend = 2 * (a - 2 * middle + b);
    const double vertex = -rise / (2 * bend);
    return vertex > 0 && vertex < 1 && a * (a + rise * vertex / 2) < 0 ? vertex : -1;
}

/* The relations with inputs at a share of the way to the present ones; false without values. */
static bool see_on_way(Instance *self, const double from[], double share, Seen *seen) {
    const Point now = present(self);
    double z[ROOM(NZ)], u[ROOM(NU)];
    memcpy(z, now.z, NZ * sizeof *z);
    memcpy(u, now.u, NU * sizeof *u);
    go_on_way(from, share, u);
    return law_see(&self->laws, &(Point){now.t, now.x, z, u}, seen);
}

/* Whether an argument may change its sign on the way: within the last leap, unless it bends. */
static bool may_change(const Instance *self, const Seen *seen) {
    const double *modes = self->state.values + FIRST_MODE;
    bool any = ENCLOSED > 0;
    for (int i = 0; i < MODES; i++) any |= is_sign(i) && seen->arguments[i] * modes[i] < 0;
    return any;
}

/* Warn, once for each relation, if inputs leap from values to the present ones over a short change:
   over many places of a term, or where results return. */
static void warn_of_leap(Instance *self, const double from[]) {
    double shares[ROOM(MODES)];
    int places = 0, place = -1, law = -1;
    Seen a, middle, b;
    if (!see_on_way(self, from, 1, &b) || !may_change(self, &b) || !see_on_way(self, from, 0, &a) ||
        !see_on_way(self, from, 0.5, &middle))
        return;
    for (int i = MODES; i-- > 0;) {
        shares[i] = -1;
        if (!is_sign(i)) continue;
        const double share = share_of_change(a.arguments[i], middle.arguments[i], b.arguments[i]);
        if (share < 0) continue;
        if (relation_table[i].in_laws)
            shares[law = i] = share;
        else
            places++, place = i;
    }
    const bool many = places > MOST_PLACES;
    const int relation = many ? place : law;
    if (relation < 0 || self->leapt[relation] || (!many && !results_return(self, from, shares)))
        return;
    self->leapt[relation] = true;
    log_text(self, WARNING,
             "at %.12g s, %s jumps over a short change of the equations ('%s'), which no step "
             "meets; give shorter steps, or how it moves within them",
             self->state.values[TIME], relation_movers[relation], relation_names[relation]);
}

/* Note the inputs at a communication point, or where they have moved or been set as an event. */
static void note_inputs(Instance *self, bool leap) {
    Leaps *leaps = &self->state.leaps;
    const double *u = self->state.values + FIRST_INPUT;
    const int known = (int)leaps->count;
    if (known > 0 && memcmp(leaps->u[0], u, sizeof leaps->u[0]) == 0) return;
    if (leap && known > 0) warn_of_leap(self, leaps->u[known - 1]);
    memcpy(leaps->u[1], leaps->u[0], sizeof leaps->u[0]);
    memcpy(leaps->u[0], u, sizeof leaps->u[0]);
    leaps->count = leap && known > 0 ? 2 : 1;
}

#else
#define note_inputs(self, leap) ((void)(self), (void)(leap))
#endif

#endif
