/* Modes that are consistent at an instant.
 *
 * The mode of a relation whose argument is 0 is that of its first time derivative that is not 0;
 * one that rests there has the value of its operator. If neither side is consistent, the relation
 * slides: its argument stays 0, and its mode is between -1 and 1.
 *
 * Source  Filippov, Differential Equations with Discontinuous Righthand Sides, Kluwer 1988.
 */
#ifndef HYBRID_SETTLE_H
#define HYBRID_SETTLE_H

#include "departure.h"

enum { MOST_ROUNDS = 100 }; /* of changes of modes, and of events, at one instant */

static const double EDGE = 1e-9;        /* by which the mode of a new sliding may leave -1 ... 1 */
static const double LEAVING = 1e-12;    /* by which a mode leaves it before that is an event, ...
                                           ... half of which ends the sliding at any instant */
static const double JUMP = 4;           /* roundings beyond which only a jump goes and rises */
static const double MOVED = 1e8;        /* roundings: by inputs and jumps, by no solver error */
static const double NO_BOUNDARY = 1e30; /* far from any: of time alone, or without a value */

/* Why the kernel cannot go on, or does not want to; sentences are made where names are known. */
typedef enum {
    GOES_ON,
    STOPPED,             /* an event has ended the run; `part`: the rule */
    NO_VALUE,            /* an expression has no value at the instant */
    NO_MODES,            /* no consistent modes; `part`: a relation that is 0 */
    TOO_MANY_ROUNDS,     /* events happen again and again; `part`: the last rule */
    TOO_CLOSE,           /* events are ever closer in time (Zeno); `part`: the last rule, or -1 */
    CONTRADICTS,         /* rules `part` and `other` give a state different values; `state` */
    NOT_FINITE_ASSIGNED, /* rule `part` gives a state no finite value; `state` */
    VIOLATES,            /* rule `part` violates constraint `other` by `size` */
    STAYS_TRUE           /* the condition of rule `part` stays true beyond its boundary */
} Reason;

typedef struct {
    Reason reason;
    int part, other, state; /* -1: none */
    double size;
} Ending;

static const Ending GOING_ON = {GOES_ON, -1, -1, -1, 0};

static inline Ending ending(Reason reason, int part) {
    return (Ending){reason, part, -1, -1, 0};
}

/* Whether an input has moved an argument away that was 0, which no equation tells. Where other
 * quantities move it, too, their errors are more than rounding; so is what importers of model
 * exchange have stepped beyond a boundary. */
static inline bool is_moved(const Laws *laws, const Switching *s, const Seen *seen, int i) {
    const double left = laws->blind ? 0 : s->left[i];
    const double way = fabs(past_boundary(laws, s, seen, i) - left);
    const int moved = laws->relations[i].moved;
    const bool exact = moved == BY_INPUTS && (!laws->blind || s->beyond[i] == 0);
    return moved && !(way <= (exact ? 1 : MOVED) * s->slack[i]);
}

/* Whether inputs alone are about to move an argument, although they rest at this instant. */
static inline bool is_bent(const Laws *laws, const Seen *seen, int i) {
    return laws->relations[i].moved == BY_INPUTS &&
           fabs(seen->seconds[i]) > ROUNDING * seen->sizes[i];
}

/* Whether the argument of a relation has stayed 0 since its last event. */
static inline bool is_held(const Laws *laws, const Switching *s, const Seen *seen, int i) {
    return s->state[i] == HELD && fabs(seen->rates[i]) <= s->stays[i] &&
           !is_moved(laws, s, seen, i) && !is_bent(laws, seen, i);
}

/* How far every relation is within its mode, and the rate of that. Rounding is inside. */
static inline void measure(const Laws *laws, const Switching *s, const double modes[],
                           const Seen *seen, double inside[], double rates[]) {
    for (int i = 0; i < MODES; i++) {
        const double mode = modes[i], value = past_boundary(laws, s, seen, i), slack = s->slack[i];
        double sign = 0;
        if (s->state[i] == SLIDES) {
            const bool jumped = !laws->blind && is_moved(laws, s, seen, i);
            inside[i] = jumped ? -1 : 1 - fabs(mode) + LEAVING;
        } else if (laws->relations[i].of_time || !isfinite(value)) {
            inside[i] = NO_BOUNDARY;
        } else if (laws->relations[i].floor) {
            sign = value - mode < mode + 1 - value ? 1 : -1;
            inside[i] = slack + (sign > 0 ? value - mode : mode + 1 - value);
        } else {
            sign = mode != 0 ? mode : value > 0 ? -1 : 1; /* a mode of 0 is that of 0 alone */
            inside[i] = slack + sign * value;
            if (is_held(laws, s, seen, i)) inside[i] = fmax(inside[i], slack);
        }
        rates[i] = sign == 0 ? 0 : sign * seen->rates[i];
    }
}

/* Whether no more than rounding of the argument and of the time, so many `times`, is between an
 * argument and its boundary, be it that it is within its mode yet, and it passes all that rounding
 * makes of it in a time that is none. What is slow beside the sizes of states has the rounding of
 * their values, if its rate is no rounding itself. */
static inline bool is_passing(const Switching *s, double t, int i, double inside, double rate,
                              double times) {
    const double way = -rate * time_scale(s, t), slack = s->slack[i];
    const bool slow = !(slack <= SAME_TIME * way), moves = !slow || -rate > s->faint[i];
    const double noise = times * (slow ? s->least[i] : slack), ahead = times * located(s, t) * way;
    return s->state[i] != SLIDES && moves && inside <= slack + noise + ahead &&
           noise <= SAME_TIME * way && way < INFINITY;
}

/* Boundaries are where the author wrote them: what has been inside since its event is free. */
static inline void note_inside(const Laws *laws, Switching *s, const double modes[],
                               const double arguments[]) {
    for (int i = 0; i < MODES; i++) {
        if (s->state[i] != LEAVES) continue;
        const double value = arguments[i], mode = modes[i];
        const double inside =
            laws->relations[i].floor ? fmin(value - mode, mode + 1 - value) : mode * value;
        if (!(inside > fabs(s->beyond[i]) + s->slack[i])) continue;
        s->state[i] = FREE;
        s->beyond[i] = 0;
    }
}

/* -- one instant ------------------------------------------------------------------------------ */

static inline double mode_by_value(bool floor_, double value) {
    return floor_ ? floor(value) : value >= 0 ? 1 : -1;
}

/* The mode of an argument that is not 0. One of time alone may be due a little later; at a start,
 * what only rounding is before happens. */
static inline double apart(const Laws *laws, const Switching *s, const Point *at, const Seen *seen,
                           int i, double value) {
    const Relation *relation = &laws->relations[i];
    if (relation->of_time) {
        const double t = event_time(laws, s, at->t), rate = seen->rates[i];
        if (relation->linear)
            value += rate * (t - at->t);
        else if (t != at->t)
            value = timed_argument(laws, at, i, t);
        const double boundary = relation->floor ? round(value) : 0;
        if (fabs(value - boundary) <= 8 * DBL_EPSILON * fabs(largest_time(s, t) * rate)) {
            if (s->next != NOT_PLANNED) return modes_of(at)[i];
            if (relation->linear) value = relation->floor ? boundary - (rate < 0) : rate;
        }
    }
    return mode_by_value(relation->floor, value);
}

/* The mode that value and rates require; `zero` tells whether the argument is 0. */
static inline double required(const Laws *laws, const Switching *s, const Point *at,
                              const Seen *seen, int i, bool *zero) {
    const Relation *relation = &laws->relations[i];
    const bool jumps = relation->of_time && s->due[i] == JUMPS;
    const double value = jumps ? timed_argument(laws, at, i, event_time(laws, s, at->t))
                               : past_boundary(laws, s, seen, i);
    const double boundary = relation->floor ? round(value) : 0, mode = modes_of(at)[i];
    if (!isfinite(value)) return mode; /* of a branch that is not taken */
    if (jumps) return mode_by_value(relation->floor, value);
    if (!*zero && value != boundary) return apart(laws, s, at, seen, i, value);
    *zero = true;
    const double along[] = {seen->rates[i], seen->seconds[i], seen->departs[i]};
    for (int k = 0; k < 3; k++) {
        if (!(fabs(along[k]) > rounding_of_rate(s, seen, i))) continue;
        if (relation->floor) return along[k] > 0 ? boundary : boundary - 1;
        return along[k] > 0 ? 1 : -1;
    }
    const bool unknown = laws->blind && relation->moved;
    if (s->state[i] == HELD && !unknown) return mode; /* it has rested since its event */
    if (relation->floor) return boundary;
    return relation->at_zero == KEEPS ? mode : relation->at_zero;
}

/* Takes what rounding makes of slow relations at a point. */
static inline bool note_least(const Laws *laws, Switching *s, const Point *at, Spread *found) {
    *found = (Spread){.sized = {0}};
    if (!laws->spread(laws->owner, at, found)) return false;
    for (int i = 0; i < MODES; i++) {
        s->least[i] = DBL_MIN + (isfinite(found->least[i]) ? ROUNDING * found->least[i] : 0);
        s->faint[i] = isfinite(found->rates[i]) ? ROUNDING * found->rates[i] : 0;
    }
    return true;
}

/* Takes what rounding makes of the relations at a point from which on it counts. */
static inline void note_slack(const Laws *laws, Switching *s, const Point *at) {
    Spread found;
    if (!note_least(laws, s, at, &found)) return;
    /* never 0: what is at its boundary is inside, and a change of the sign shows that it leaves */
    for (int i = 0; i < MODES; i++)
        s->slack[i] = DBL_MIN + (isfinite(found.sized[i]) ? ROUNDING * found.sized[i] : 0);
}

/* Ends the sliding of relations whose modes have left -1 ... 1, on the side that the mode tells. */
static inline bool release(Switching *s, double modes[], bool zero[], bool kept[]) {
    bool any = false;
    for (int i = 0; i < MODES; i++) {
        if (s->state[i] != SLIDES || fabs(modes[i]) <= 1 + EDGE) continue;
        s->state[i] = FREE;
        modes[i] = modes[i] > 0 ? 1 : -1;
        zero[i] = kept[i] = any = true;
    }
    return any;
}

/* What a change of modes has moved is no longer 0 because it was so before. */
static inline void note_jumps(Switching *s, const Seen *before, const Seen *now, bool zero[]) {
    for (int i = 0; i < MODES; i++) {
        const double size = fabs(before->arguments[i]) + fabs(now->arguments[i]);
        const double way = fabs(now->arguments[i] - before->arguments[i]);
        const double tiny = 4 * s->slack[i] + ROUNDING * size;
        /* what is 0 but for rounding may change its side, as |x| does with the sign of x */
        const bool turned = zero[i] && fabs(now->arguments[i] + before->arguments[i]) <= tiny;
        if (s->state[i] == SLIDES || turned || !(way > tiny)) continue;
        zero[i] = false;
        s->state[i] = FREE;
        s->beyond[i] = 0;
    }
}

/* Changes the first mode that is not consistent, or the last one, or lets its relation slide; false
 * without a value. */
static inline bool change_one(const Laws *laws, Switching *s, const Point *at, const Seen *seen,
                              bool zero[], const bool decided[], const bool kept[], bool back,
                              bool *changed) {
    double *modes = modes_of(at);
    for (int k = 0; k < MODES; k++) {
        const int i = back ? MODES - 1 - k : k;
        if (s->state[i] == SLIDES || decided[i]) continue;
        if (kept[i] && zero[i] && rests_on(s, seen, i)) continue;
        bool at_zero = zero[i];
        const double mode = required(laws, s, at, seen, i, &at_zero);
        if (mode == modes[i]) continue;
        *changed = true;
        modes[i] = mode;
        if (!at_zero || laws->relations[i].floor || laws->relations[i].of_time) return true;
        Seen other;
        if (!look_along(laws, s, at, &other)) return false;
        look_ahead(laws, s, at, zero, &other);
        if (required(laws, s, at, &other, i, &at_zero) != mode) {
            s->state[i] = SLIDES;
            zero[i] = true;
        }
        return true;
    }
    return true;
}

/* Whether an argument that became 0 came to rest beyond it, where its value decides, and does not
 * come back. */
static inline bool rests_beyond(const Laws *laws, const Switching *s, const Point *at,
                                const Seen *seen, int i) {
    if (laws->relations[i].floor || s->state[i] == SLIDES) return false;
    const double past = modes_of(at)[i] * past_boundary(laws, s, seen, i);
    return seems_to_rest(s, seen, i) && past < -s->slack[i] && !decays(laws, s, at, seen, i);
}

/* Notes what is 0 where modes are settled, and whether it stays so by definition. */
static inline void note_zeros(const Laws *laws, Switching *s, const Seen *seen, const bool zero[]) {
    for (int i = 0; i < MODES; i++) {
        const double value = seen->arguments[i], tiny = ROUNDING * seen->sizes[i];
        s->stays[i] = 0;
        if (s->state[i] == HELD) s->state[i] = LEAVES;
        if (!zero[i] || laws->relations[i].of_time || !isfinite(value)) continue;
        const bool rests = rests_on(s, seen, i);
        if (rests) s->stays[i] = tiny;
        if (s->state[i] != SLIDES) s->state[i] = rests ? HELD : LEAVES;
        s->left[i] = laws->relations[i].floor ? round(value) : 0;
        s->beyond[i] = value - s->left[i];
    }
}

/* Adds arguments that new values have moved to where only rounding keeps them within their modes to
 * those that are 0, if their rates are known; importers locate events with larger errors. */
static inline void note_passing(const Laws *laws, const Switching *s, const Point *at,
                                const Seen *seen, const bool moved[], bool zero[]) {
    double inside[MODES + 1], rates[MODES + 1];
    measure(laws, s, modes_of(at), seen, inside, rates);
    for (int i = 0; i < MODES; i++) {
        const Relation *relation = &laws->relations[i];
        const bool known = !relation->of_time && !(laws->blind && relation->moved);
        const bool rounded = inside[i] >= 0 && (laws->blind || inside[i] <= 2 * s->slack[i]);
        const bool passes = rounded && is_passing(s, at->t, i, inside[i], rates[i], 1);
        zero[i] = zero[i] || (moved[i] && known && passes);
    }
}

/* Finds modes that are consistent with what follows.
 *
 * zero: relations whose arguments are 0, whatever rounding makes of them; more may be found.
 * decided: relations that keep their modes although their arguments are 0.
 * moved: relations whose arguments new values have moved; NULL: none. */
static inline Ending settle(const Laws *laws, Switching *s, const Point *at, bool zero[],
                            const bool decided[], const bool moved[]) {
    bool kept[MODES + 1] = {0}; /* as released, where others slide instead */
    Seen seen, before;
    for (int trial = 0; trial < MOST_ROUNDS; trial++) {
        if (!look_or_release(laws, s, at, zero, &seen)) return ending(NO_VALUE, -1);
        note_slack(laws, s, at);
        for (int i = 0; i < MODES && trial == 0; i++)
            if (zero[i] && rests_beyond(laws, s, at, &seen, i)) zero[i] = false;
        look_ahead(laws, s, at, zero, &seen);
        if (trial > 0) note_jumps(s, &before, &seen, zero);
        if (moved) note_passing(laws, s, at, &seen, moved, zero);
        before = seen;
        bool changed = release(s, modes_of(at), zero, kept);
        const bool back = trial > 2 * MODES && trial % 2 != 0; /* breaks cycles */
        if (!changed && !change_one(laws, s, at, &seen, zero, decided, kept, back, &changed))
            return ending(NO_VALUE, -1);
        if (changed) continue;
        note_zeros(laws, s, &seen, zero);
        note_inside(laws, s, modes_of(at), seen.arguments);
        return GOING_ON;
    }
    int last = 0;
    for (int i = 0; i < MODES; i++)
        if (zero[i]) last = i;
    return ending(NO_MODES, last);
}

/* The first modes by the values of arguments alone; comparisons of what has none are false. */
static inline void guess_modes(const Laws *laws, const Point *at, int count) {
    double *modes = modes_of(at);
    Seen seen;
    const bool defined = laws->see(laws->owner, at, &seen);
    for (int i = 0; i < count; i++) {
        const double value = defined ? seen.arguments[i] : NAN;
        const bool compares = laws->relations[i].at_zero * laws->relations[i].at_zero == 1;
        if (isfinite(value))
            modes[i] = mode_by_value(laws->relations[i].floor, value);
        else
            modes[i] = compares && !laws->relations[i].floor ? -1 : 1;
    }
}

/* The modes of a start, with nothing left from before. */
static inline Ending begin_modes(const Laws *laws, Switching *s, const Point *at, double span) {
    bool zero[MODES + 1] = {0};
    const bool decided[MODES + 1] = {0};
    memset(s, 0, sizeof *s);
    s->next = s->last = s->reached = NOT_PLANNED;
    s->span = span;
    s->start = at->t;
    for (int i = 0; i < MODES; i++) modes_of(at)[i] = 1;
    /* arguments may hold the modes of others, most of them of relations before them */
    for (int i = 1; i <= MODES; i++) guess_modes(laws, at, i);
    guess_modes(laws, at, MODES);
    return settle(laws, s, at, zero, decided, NULL);
}

#endif
