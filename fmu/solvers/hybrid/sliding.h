/* Relations that slide: their arguments stay 0, and their modes follow from that.
 */
#ifndef HYBRID_SLIDING_H
#define HYBRID_SLIDING_H

#include "linear.h"
#include "switching.h"

static const double NOT_AFFINE = 1e-8; /* rate of an argument that should stay, relative */

/* Sets the modes of relations that slide so that the rates of their arguments balance a drift, and
 * tells in `one` what follows; false where none do. The rates are affine in the modes: both sides
 * tell how. A mode of exactly 0 is that of rest. */
static inline bool balance(const Laws *laws, const Switching *s, const Point *at,
                           const double drift[], Seen *one) {
    double *modes = modes_of(at), *a = laws->room, sizes[MODES + 1], b[MODES + 1];
    int which[MODES + 1], n = 0;
    Seen base;
    for (int i = 0; i < MODES; i++)
        if (s->state[i] == SLIDES) which[n++] = i;
    if (n == 0) return true;

    for (int k = 0; k < n; k++) modes[which[k]] = -1;
    if (!laws->see(laws->owner, at, &base)) return false;
    for (int k = 0; k < n; k++) {
        b[k] = -base.rates[which[k]] - drift[which[k]];
        sizes[k] = fabs(b[k]);
    }
    for (int c = 0; c < n; c++) {
        modes[which[c]] = 1;
        if (!laws->see(laws->owner, at, one)) return false;
        modes[which[c]] = -1;
        for (int r = 0; r < n; r++) {
            a[r * n + c] = (one->rates[which[r]] - base.rates[which[r]]) / 2;
            sizes[r] += fabs(a[r * n + c]);
        }
    }
    if (solve_dense(n, a, b)) return false;
    for (int k = 0; k < n; k++) modes[which[k]] = b[k] == 1 ? DBL_MIN : b[k] - 1;
    if (!laws->see(laws->owner, at, one)) return false;
    for (int k = 0; k < n; k++)
        if (!(fabs(one->rates[which[k]] + drift[which[k]]) <= NOT_AFFINE * sizes[k])) return false;
    return true;
}

/* Sets the modes of relations that slide; false where none keep their arguments. */
static inline bool follow(const Laws *laws, const Switching *s, const Point *at) {
    const double none[MODES + 1] = {0};
    Seen seen;
    return balance(laws, s, at, none, &seen);
}

/* Relations at a point, whatever slides. */
static inline bool look_closely(const Laws *laws, const Switching *s, const Point *at, Seen *seen) {
    return follow(laws, s, at) && laws->see(laws->owner, at, seen);
}

/* The same with second derivatives of a motion along which the modes that slide change, too: so are
 * those of what slides 0, and of all that this keeps where it is. */
static inline bool look_along(const Laws *laws, const Switching *s, const Point *at, Seen *seen) {
    double z[NZ + 1], u[NU + 1];
    Seen turned;
    if (!look_closely(laws, s, at, seen)) return false;
    for (int i = 0; i < NZ; i++) z[i] = at->z[i];
    memcpy(u, at->u, NU * sizeof *u);
    const Point aside = {at->t, at->x, z, u};
    if (!any_is(s, SLIDES) || !balance(laws, s, &aside, seen->seconds, &turned)) return true;
    for (int i = 0; i < MODES; i++) {
        const double change = turned.rates[i] - seen->rates[i], sum = seen->seconds[i] + change;
        const double size = fabs(change) + fabs(turned.rates[i]) + seen->sizes[i];
        seen->seconds[i] = fabs(sum) > ROUNDING * size ? sum : 0;
    }
    return true;
}

/* Ends the sliding of relations whose arguments no mode keeps at 0 any more, as where a friction
 * force vanishes: they go where their rates lead. Returns whether there are any. */
static inline bool release_unkept(const Laws *laws, Switching *s, const Point *at, bool zero[]) {
    double *modes = modes_of(at);
    bool any = false;
    Seen without, with;
    for (int i = 0; i < MODES; i++)
        if (s->state[i] == SLIDES) modes[i] = -1;
    if (!laws->see(laws->owner, at, &without)) return false;
    for (int i = 0; i < MODES; i++) {
        if (s->state[i] != SLIDES) continue;
        modes[i] = 1;
        if (!laws->see(laws->owner, at, &with)) return false;
        modes[i] = -1;
        const double change = fabs(with.rates[i] - without.rates[i]);
        if (change > ROUNDING * (without.sizes[i] + fabs(without.rates[i]))) continue;
        s->state[i] = FREE;
        modes[i] = without.rates[i] < 0 ? -1 : 1;
        zero[i] = any = true;
    }
    return any;
}

/* Relations at an instant, where some may no longer slide. */
static inline bool look_or_release(const Laws *laws, Switching *s, const Point *at, bool zero[],
                                   Seen *seen) {
    return look_along(laws, s, at, seen) ||
           (release_unkept(laws, s, at, zero) && look_along(laws, s, at, seen));
}

#endif
