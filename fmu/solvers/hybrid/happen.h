/* One instant: modes, assignments of the rules whose conditions have risen, and what follows.
 *
 * All rules that have risen assign at once, from the values before; then the conditions are looked
 * at again, until none rises: a round each.
 */
#ifndef HYBRID_HAPPEN_H
#define HYBRID_HAPPEN_H

#include "settle.h"

static const double TINY = 1e-280;    /* s; a time that is not 0 if it is divided by a period; ...
                                         ... below, a new value is 0, as a mode of what slides is */
static const double CLOSE = 1e-10;    /* distance of events, relative to 1 s or the run, or ... */
static const double FEW_ULPS = 64;    /* ... roundings of the time, of which ... */
enum { MOST_CLOSE = 10 };             /* ... so many in succession are no motion, as are ... */
static const double NO_WAY = 100;     /* ... those between which arguments move so many roundings */
static const double VIOLATION = 1e-6; /* of a constraint, that an assignment may leave ... */
static const double WORSE = 10;       /* ... or so many times the one before */

/* All that happened at an instant. */
typedef struct {
    Ending ending;
    int count, rounds;
    bool states_changed, modes_changed;
    int happened[MOST_ROUNDS * EVENTS + 1]; /* rules, in their order */
    double modes[MODES + 1];                /* before */
    bool zero[MODES + 1];                   /* arguments that were 0 before the first assignment */
} Happening;

/* What a caller wants to know of each round: the values before its assignments. */
typedef void NoteRound(void *listener, const Point *before, const bool risen[]);

typedef struct {
    NoteRound *note;
    void *listener;
} Listener;

static inline bool decide(const Laws *laws, const Switching *s, const Point *at, Decision *found) {
    return follow(laws, s, at) && laws->decide(laws->owner, at, found);
}

/* -- the start -------------------------------------------------------------------------------- */

/* Modes of relations of time alone by their values at a time. */
static inline void modes_of_time(const Laws *laws, const Point *at, double t, double modes[]) {
    double arguments[MODES + 1], rates[MODES + 1];
    if (!laws->timed(laws->owner, at, t, arguments, rates)) return;
    for (int i = 0; i < MODES; i++) {
        const Relation *relation = &laws->relations[i];
        if (!relation->of_time || !isfinite(arguments[i])) continue;
        if (relation->floor || arguments[i] != 0)
            modes[i] = mode_by_value(relation->floor, arguments[i]);
        else if (relation->at_zero != KEEPS)
            modes[i] = relation->at_zero;
    }
}

/* Modes by value, whatever follows: at a boundary those of the operators, and of what holds others'
 * modes, such as floor(x) < 1, those that follow from these. */
static inline bool modes_of_values(const Laws *laws, const Switching *s, const Point *at,
                                   const Seen *seen) {
    for (int i = 0; i < MODES; i++) {
        const Relation *relation = &laws->relations[i];
        Seen now;
        if (s->state[i] == SLIDES) continue;
        if (!laws->see(laws->owner, at, &now)) return false;
        const double value = now.arguments[i], boundary = relation->floor ? round(value) : 0;
        if (value == boundary && !relation->floor && relation->at_zero != KEEPS)
            modes_of(at)[i] = relation->at_zero;
        else if (isfinite(value) && (value != seen->arguments[i] || value == boundary))
            modes_of(at)[i] = mode_by_value(relation->floor, value);
    }
    return true;
}

/* The conditions before the start: at a boundary, where only the value has been decisive; of
 * samples their number, as one may be due at the start itself. */
static inline Ending begin_events(const Laws *laws, Switching *s, const Point *at) {
    double *modes = modes_of(at), here[MODES + 1];
    Decision now, before, literal;
    Seen seen;
    if (!decide(laws, s, at, &now) || !look_closely(laws, s, at, &seen))
        return ending(NO_VALUE, -1);
    for (int i = 0; i < EVENTS; i++)
        if (laws->rules[i].ends && now.conditions[i] > 0) return ending(STOPPED, i);

    memcpy(here, modes, sizeof here - sizeof *here);
    modes_of_time(laws, at, at->t - 8 * DBL_EPSILON * fmax(fabs(at->t), TINY), modes);
    bool valued = laws->decide(laws->owner, at, &before);
    memcpy(modes, here, sizeof here - sizeof *here);
    valued =
        valued && modes_of_values(laws, s, at, &seen) && laws->decide(laws->owner, at, &literal);
    memcpy(modes, here, sizeof here - sizeof *here);
    if (!valued) return ending(NO_VALUE, -1);
    for (int i = 0; i < EVENTS; i++)
        s->conditions[i] = laws->rules[i].sampled ? fmin(now.conditions[i], before.conditions[i])
                                                  : literal.conditions[i];
    return GOING_ON;
}

/* Conditions at the present time by value, as far as they count samples. */
static inline void samples_at(const Laws *laws, const Switching *s, const Point *at,
                              double counts[]) {
    double *modes = modes_of(at), here[MODES + 1];
    Decision now = {.conditions = {0}};
    memcpy(here, modes, sizeof here - sizeof *here);
    modes_of_time(laws, at, at->t + 8 * DBL_EPSILON * largest_time(s, at->t), modes);
    const bool valued = decide(laws, s, at, &now);
    for (int i = 0; i < EVENTS; i++)
        counts[i] = laws->rules[i].sampled && valued ? now.conditions[i] : s->conditions[i];
    memcpy(modes, here, sizeof here - sizeof *here);
}

/* -- an instant ------------------------------------------------------------------------------- */

/* Arguments that rest where a search has found a crossing, and nothing else is known to happen,
 * have only approached their boundary: their modes are held. */
static inline void note_approaches(const Laws *laws, Switching *s, const Point *at,
                                   const bool zero[], Seen *seen) {
    look_ahead(laws, s, at, zero, seen);
    for (int i = 0; i < MODES; i++) {
        const bool unknown = laws->blind && laws->relations[i].moved;
        const bool other = laws->relations[i].of_time || s->state[i] == SLIDES || unknown;
        if (zero[i] && !other && rests_on(s, seen, i)) s->state[i] = HELD;
    }
}

/* Which arguments are 0, and which relations no longer slide; `reached`: those that rest there are
 * left out. Returns how far arguments have moved since the last event, in roundings; -1 without a
 * value. */
static inline double find_switched(const Laws *laws, Switching *s, const Point *at, int crossing,
                                   const bool later[], bool zero[], bool decided[],
                                   bool reached[]) {
    double *modes = modes_of(at), inside[MODES + 1], rates[MODES + 1], way = 0;
    bool rests[MODES + 1] = {0};
    Seen seen;
    if (!look_or_release(laws, s, at, zero, &seen)) return -1;
    measure(laws, s, modes, &seen, inside, rates);
    const double t = event_time(laws, s, at->t), scale = time_scale(s, t);
    const double late = laws->blind ? SAME_TIME : located(s, t); /* as importers come to an event */
    double wait = 0;   /* until all that only rounding keeps within its mode is beyond rounding */
    double missed = 0; /* by an importer that is late or early, which moves what follows */
    for (int i = 0; i < MODES; i++)
        if (is_passing(s, t, i, inside[i], rates[i], 1)) wait = fmax(wait, inside[i] / -rates[i]);
    wait = fmin(wait, SAME_TIME * scale); /* a relation may pass ever so slowly */
    for (int i = 0; i < MODES; i++) {
        const Relation *relation = &laws->relations[i];
        const bool held = is_held(laws, s, &seen, i);
        if (s->state[i] == HELD && !held && !laws->blind) s->state[i] = LEAVES;
        if (later[i]) {
            decided[i] = true;
        } else if (zero[i]) {
            continue; /* it has just been released */
        } else if (s->state[i] == SLIDES) {
            const bool moved = is_moved(laws, s, &seen, i);
            if (!moved && i != crossing && inside[i] > LEAVING / 2) continue;
            s->state[i] = FREE;
            modes[i] = (moved ? seen.arguments[i] : modes[i]) > 0 ? 1 : -1;
            zero[i] = decided[i] = !moved;
            if (moved) s->beyond[i] = 0;
        } else if (held) {
            zero[i] = rests[i] = true;
        } else if (relation->of_time) {
            zero[i] = s->due[i] != JUMPS && is_due(s, i, t) && s->next != NOT_PLANNED;
        } else {
            const double speed = fabs(rates[i]) * scale, gap = inside[i] - s->slack[i];
            const double ahead = fmax(LOCATED * speed, -rates[i] * wait);
            /* what is beyond and comes back was only touched, within the error of a solver */
            const double error = (rates[i] > 0 && !laws->blind ? MOVED : 2) * s->slack[i];
            const bool crossed = gap <= ahead && gap >= -late * speed - error;
            /* where rates of inputs are unknown, an argument that has passed its boundary against
             * the known rate has been moved there, and its value decides */
            const double past = past_boundary(laws, s, &seen, i);
            const bool beyond = is_beyond(relation->floor, modes[i], past);
            const bool moved =
                laws->blind && relation->moved && beyond && rates[i] >= -ROUNDING * seen.sizes[i];
            /* an angle has jumped by a turn: then the search has met no crossing */
            const double most = JUMP * s->slack[i] + (rates[i] < 0 ? late * speed : 0);
            const bool jumped = i == crossing && gap < -most;
            zero[i] = (i == crossing || crossed) && !moved && !jumped;
            rests[i] = i != crossing && !(rates[i] < 0);
            if (zero[i]) way = fmax(way, fabs(rates[i]) * (t - s->last) / s->slack[i]);
            if (crossed && rates[i] < 0) missed = fmax(missed, fabs(gap / rates[i]));
        }
    }
    if (laws->blind) s->rounded += fmin(missed / scale, SAME_TIME) / DBL_EPSILON;
    if (crossing >= 0 || (laws->blind && !laws->set)) note_approaches(laws, s, at, zero, &seen);
    for (int i = 0; i < MODES; i++) reached[i] = zero[i] && !rests[i];
    return way;
}

static inline bool find_risen(const Laws *laws, const double before[], const double now[],
                              bool risen[]) {
    bool any = false;
    for (int i = 0; i < EVENTS; i++) {
        risen[i] = now[i] > before[i] && !(laws->rules[i].sampled && now[i] < 0);
        any |= risen[i];
    }
    return any;
}

/* New values of the states by the rules that happen. What several of them add to a state adds up;
 * other assignments to one state must be equal. */
static inline Ending new_values(const Laws *laws, const Decision *at, const bool risen[],
                                const double x[], double assigned[]) {
    int by[NX + 1]; /* the last rule that gives a state its value */
    bool adds[NX + 1] = {false};
    for (int i = 0; i < NX; i++) by[i] = -1;
    memcpy(assigned, x, NX * sizeof *x);
    for (int i = 0; i < EVENTS; i++) {
        const Rule *rule = &laws->rules[i];
        for (int k = rule->first; risen[i] && k < rule->first + rule->count; k++) {
            const int state = laws->assigned[k];
            const double found = at->values[k], value = fabs(found) < TINY ? 0 : found;
            if (!isfinite(value)) return (Ending){NOT_FINITE_ASSIGNED, i, -1, state, value};
            if (by[state] < 0)
                assigned[state] = value;
            else if (adds[state] && laws->adds[k])
                assigned[state] += value - x[state];
            else if (assigned[state] != value)
                return (Ending){CONTRADICTS, i, by[state], state, value};
            adds[state] = (by[state] < 0 || adds[state]) && laws->adds[k];
            by[state] = i;
        }
    }
    return GOING_ON;
}

/* Assigns what the rules that happen say; arguments that this moves are no longer 0. */
static inline Ending assign(const Laws *laws, Switching *s, const Point *at, const Decision *rules,
                            const bool risen[], double x[], bool zero[], bool moved[]) {
    double assigned[NX + 1];
    Seen was, is;
    Decision after;
    if (!look_closely(laws, s, at, &was)) return ending(NO_VALUE, -1);
    Ending found = new_values(laws, rules, risen, x, assigned);
    if (found.reason != GOES_ON) return found;
    memcpy(x, assigned, NX * sizeof *x);
    if (!look_closely(laws, s, at, &is) || !decide(laws, s, at, &after))
        return ending(NO_VALUE, -1);
    int first = 0;
    while (!risen[first]) first++;
    for (int k = 0; k < DEFECTS; k++) {
        const double now = after.defects[k];
        if (now > VIOLATION && now > WORSE * rules->defects[k])
            return (Ending){VIOLATES, first, k, -1, now};
    }
    for (int i = 0; i < MODES; i++) {
        const bool same = is.arguments[i] == was.arguments[i];
        moved[i] = !same;
        zero[i] = same && (zero[i] || s->state[i] == SLIDES);
        if (s->state[i] == SLIDES) {
            s->state[i] = FREE;
            modes_of(at)[i] = modes_of(at)[i] < 0 ? -1 : 1;
        }
        if (same) continue;
        s->state[i] = FREE;
        s->beyond[i] = 0;
    }
    return GOING_ON;
}

/* The condition of a rule that stays true beyond its boundary: the rule has assigned states on
 * which the rate of the boundary depends, that rate is 0, and the second one leads further in. If
 * events have come closer and closer before, this is where they die out. */
static inline Ending reject_staying(const Laws *laws, const Switching *s, const Point *at,
                                    const bool happened[], const bool zero[]) {
    Decision now;
    Seen seen;
    bool doubt = false;
    for (int i = 0; i < EVENTS; i++) doubt |= happened[i] && laws->rules[i].barriers > 0;
    if (!doubt) return GOING_ON;
    if (!decide(laws, s, at, &now) || !look_along(laws, s, at, &seen)) return ending(NO_VALUE, -1);
    for (int i = 0; i < EVENTS; i++) {
        const Rule *rule = &laws->rules[i];
        if (!happened[i] || !(now.conditions[i] > 0)) continue;
        for (int k = rule->barrier; k < rule->barrier + rule->barriers; k++) {
            const int j = laws->barriers[k];
            const double tiny = ROUNDING * seen.sizes[j];
            if (zero[j] && s->state[j] != SLIDES && fabs(seen.rates[j]) <= tiny &&
                modes_of(at)[j] * seen.seconds[j] > tiny)
                return ending(s->close > 0 ? TOO_CLOSE : STAYS_TRUE, i);
        }
    }
    return GOING_ON;
}

/* Lets rules happen until no condition rises. */
static inline Ending iterate(const Laws *laws, Switching *s, const Point *at, double x[],
                             const bool later[], bool zero[], const Listener *listener,
                             Happening *found) {
    bool happened[EVENTS + 1] = {0};
    for (;;) {
        Decision rules;
        bool risen[EVENTS + 1] = {0}, moved[MODES + 1] = {0};
        if (!decide(laws, s, at, &rules)) return ending(NO_VALUE, -1);
        const bool any = find_risen(laws, s->conditions, rules.conditions, risen);
        memcpy(s->conditions, rules.conditions, EVENTS * sizeof *s->conditions);
        if (!any) return reject_staying(laws, s, at, happened, zero);
        const int last = found->count ? found->happened[found->count - 1] : -1;
        if (found->rounds++ == MOST_ROUNDS) return ending(TOO_MANY_ROUNDS, last);
        for (int i = 0; i < EVENTS; i++) {
            if (!risen[i]) continue;
            happened[i] = true;
            found->happened[found->count++] = i;
        }
        if (listener) listener->note(listener->listener, at, risen);
        Ending ends = assign(laws, s, at, &rules, risen, x, zero, moved);
        if (ends.reason == GOES_ON) ends = settle(laws, s, at, zero, later, moved);
        for (int i = 0; i < EVENTS && ends.reason == GOES_ON; i++)
            if (risen[i] && laws->rules[i].ends) ends = ending(STOPPED, i);
        if (ends.reason == STOPPED) s->stopped = 1;
        if (ends.reason != GOES_ON) return ends;
    }
}

/* Events that are ever closer in time are no motion that can be followed. */
static inline Ending reject_zeno(Switching *s, double t, int rule, double way) {
    const double closest = fmax(CLOSE * time_scale(s, 0), FEW_ULPS * DBL_EPSILON * fabs(t));
    const bool near = t - s->last < closest;
    s->close = near || (way > 0 && way < NO_WAY) ? s->close + 1 : 0;
    s->last = t;
    return s->close <= MOST_CLOSE ? GOING_ON : ending(TOO_CLOSE, rule);
}

/* The modes at a point, as events there find them before any assignment. */
static inline Ending settle_by_value(const Laws *laws, Switching *s, const Point *at) {
    const bool later[MODES + 1] = {0};
    bool zero[MODES + 1] = {0}, decided[MODES + 1] = {0}, reached[MODES + 1];
    if (find_switched(laws, s, at, -1, later, zero, decided, reached) < 0)
        return ending(NO_VALUE, -1);
    return settle(laws, s, at, zero, decided, NULL);
}

/* All that happens at a point; `crossing` is the relation whose argument is 0 there, or -1; those
 * that switch `later` keep their modes. States and modes change in place; where nothing is due,
 * nothing does, however often it is called. The caller plans time events anew where modes of time
 * have changed, or one was due: returned in `replan`. The point's x must be x. */
static inline void happen(const Laws *laws, Switching *s, const Point *at, double x[], int crossing,
                          const bool later[], const Listener *listener, Happening *found,
                          bool *replan) {
    const double t = event_time(laws, s, at->t), *modes = modes_of(at);
    double before[NX + 1];
    bool zero[MODES + 1] = {0}, decided[MODES + 1] = {0};
    found->ending = GOING_ON;
    found->count = found->rounds = 0;
    found->states_changed = found->modes_changed = *replan = false;
    memcpy(before, x, NX * sizeof *x);
    follow(laws, s, at); /* modes that slide are those of now */
    memcpy(found->modes, modes, MODES * sizeof *modes);
    memset(found->zero, 0, sizeof found->zero);
    if (s->stopped > 0) {
        found->ending = ending(STOPPED, -1);
        return;
    }
    const bool timed = s->next <= t && s->next != NOT_PLANNED;
    if (timed) s->reached = t;
    const double way = find_switched(laws, s, at, crossing, later, zero, decided, found->zero);
    found->ending = way < 0 ? ending(NO_VALUE, -1) : settle(laws, s, at, zero, decided, NULL);
    if (found->ending.reason == GOES_ON)
        found->ending = iterate(laws, s, at, x, later, zero, listener, found);
    if (found->ending.reason != GOES_ON && found->ending.reason != STOPPED) return;

    *replan = !(s->next > t);
    for (int i = 0; i < MODES; i++) {
        if (modes[i] == found->modes[i]) continue;
        found->modes_changed = true;
        *replan |= laws->relations[i].of_time;
    }
    found->states_changed = memcmp(before, x, NX * sizeof *x) != 0;
    const bool any = found->count > 0 || found->modes_changed;
    if (!any || timed || found->ending.reason == STOPPED) return;
    const int last = found->count ? found->happened[found->count - 1] : -1;
    s->rounded += LOCATED / DBL_EPSILON;
    found->ending = reject_zeno(s, t, last, way);
}

#endif
