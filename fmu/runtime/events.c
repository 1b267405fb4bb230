/* Events: relations that leave their modes, assignments, ends of runs.

   All assignments of conditions that have risen are made at once, from the values before; then the
   conditions are looked at again, until none rises. */
#include "events.h"

#include <math.h>
#include <string.h>

#include "equations.h"
#include "evaluation.h"
#include "logging.h"
#include "time_events.h"

#if HAS_EVENTS

static const double TINY = 1e-280; /* s; a time that is not 0 if it is divided by a period */
static const double CLOSE = 1e-10; /* relative distance of events of which ... */
enum { MOST_CLOSE = 10 };          /* ... so many in succession are no motion, as are ... */
static const double NO_WAY = 100;  /* ... those between which arguments move so many roundings */

typedef struct {
    double conditions[ROOM(N_EVENTS)], values[ROOM(N_ASSIGNED)];
    double defect; /* largest violation of an invariant */
} Rules;

static Status evaluate_rules(Instance *self, Rules *rules) {
    const Status status = refresh(self, ALGEBRAICS);
    if (status != OK) return status;
    pass_values(self);
    self->res[0] = rules->conditions;
    self->res[1] = rules->values;
    self->res[2] = &rules->defect;
    if (!model_conditions(self->arg, self->res, self->iw, self->w, 0)) return OK;
    return refuse(self, DISCARD, "the conditions of the events cannot be computed at time %.17g",
                  self->state.values[TIME]);
}

static Status fail(Instance *self) {
    return refuse(self, ERROR, "the event at %.12g s has no result", self->state.values[TIME]);
}

double next_event(const Instance *self) {
    return self->state.switching.next;
}

double end_with_event(const Instance *self, double end) {
    const double next = next_event(self);
    return next > end && next <= end + 8 * DBL_EPSILON * fabs(end) ? next : end;
}

bool run_stopped(const Instance *self) {
    return self->state.switching.stopped > 0;
}

/* -- the start ------------------------------------------------------------------------------- */

Status begin_events(Instance *self) {
    State *state = &self->state;
    double *modes = state->values + FIRST_MODE, here[ROOM(N_MODES)];
    Rules now, before, literal;
    if (evaluate_rules(self, &now) != OK) return fail(self);
    for (int i = 0; i < N_EVENTS; i++)
        if (events[i].message && now.conditions[i] > 0)
            return refuse(self, ERROR,
                          "stop '%s' is true at the start already; give a condition that becomes "
                          "true later",
                          events[i].message);

    for (const int *place = pulse_parameters; N_PULSES > 0 && *place >= 0; place++) {
        const VariableInfo *parameter = &variables[FIRST_PARAMETER + *place];
        if (state->values[FIRST_PARAMETER + *place] != parameter->start)
            log_text(self, WARNING,
                     "%s moves a short pulse of the equations, which a solver may step over; "
                     "export the model with the new value",
                     parameter->name);
    }

    /* a sample may be due at the start itself; at a boundary the value alone was decisive before */
    const double t = state->values[TIME];
    Seen seen;
    if (watch_relations(self, &seen) != OK) return fail(self);
    memcpy(here, modes, N_MODES * sizeof *modes);
    modes_of_time(self, t - 8 * DBL_EPSILON * fmax(fabs(t), TINY), modes);
    Status status = evaluate_rules(self, &before);
    for (int i = 0; i < N_MODES; i++)
        modes[i] = seen.arguments[i] == 0 && relations[i].at_zero ? relations[i].at_zero : here[i];
    if (status == OK) status = evaluate_rules(self, &literal);
    memcpy(modes, here, N_MODES * sizeof *modes);
    if (status != OK) return fail(self);
    for (int i = 0; i < N_EVENTS; i++)
        state->switching.conditions[i] = events[i].sampled
                                             ? fmin(now.conditions[i], before.conditions[i])
                                             : literal.conditions[i];
    return OK;
}

/* -- one instant ----------------------------------------------------------------------------- */

/* Whether a relation of time alone switches at a time. */
static bool is_due(const Switching *s, int i, double t) {
    return (s->due[i] == JUMPS ? s->next : s->due[i]) <= t + 8 * DBL_EPSILON * fabs(t);
}

/* Which arguments are 0, and which relations no longer slide. `way`: how far they have moved since
   the last event, in roundings. */
static Status find_switched(Instance *self, int crossing, bool zero[], bool decided[],
                            double *way) {
    Switching *s = &self->state.switching;
    double *modes = self->state.values + FIRST_MODE, inside[ROOM(N_MODES)], rates[ROOM(N_MODES)];
    Seen seen;
    const Status status = watch_relations(self, &seen);
    if (status != OK) return status;
    measure(self, modes, &seen, inside, rates);
    const double t = event_time(self), span = fmax(1, fabs(t));
    for (int i = 0; i < N_MODES; i++) {
        if (s->slides[i] > 0) {
            const bool moved = is_moved(self, &seen, i);
            if (!moved && i != crossing && inside[i] > 0) continue;
            s->slides[i] = 0;
            modes[i] = (moved ? seen.arguments[i] : modes[i]) > 0 ? 1 : -1;
            self->state.stale |= AFTER_START;
            zero[i] = decided[i] = !moved;
            if (moved) s->offsets[i] = 0;
        } else if (is_held(self, &seen, i)) {
            zero[i] = true;
        } else if (relations[i].of_time) {
            zero[i] = s->due[i] != JUMPS && is_due(s, i, t) && s->next != NOT_PLANNED;
        } else {
            const double speed = fabs(rates[i]) * span, gap = inside[i] - s->slack[i];
            const bool crossed =
                gap <= 8 * DBL_EPSILON * speed && gap >= -SAME_TIME * speed - 2 * s->slack[i];
            /* an importer of model exchange tells no rates of inputs: an argument that has passed
               its boundary against the known rate has been moved there, and its value decides */
            const double past = seen.arguments[i] - s->offsets[i];
            const bool beyond =
                relations[i].floor ? past < modes[i] || past >= modes[i] + 1 : modes[i] * past < 0;
            const bool blind = self->state.interface == INTERFACE_ME && relations[i].of_input;
            const bool moved = blind && beyond && rates[i] >= -ROUNDING * seen.sizes[i];
            zero[i] = (i == crossing || crossed) && !moved;
            if (zero[i]) *way = fmax(*way, fabs(rates[i]) * (t - s->last) / s->slack[i]);
        }
    }
    return OK;
}

static int first_risen(const double before[], const double now[], bool risen[]) {
    int first = -1;
    for (int i = N_EVENTS; i-- > 0;) {
        risen[i] = now[i] > before[i] && !(events[i].sampled && now[i] < 0);
        if (risen[i]) first = i;
    }
    return first;
}

/* Assign the new values of the events that happen; arguments that change are no longer 0. */
static Status assign(Instance *self, const Rules *rules, const bool risen[], bool zero[]) {
    Switching *s = &self->state.switching;
    double *x = self->state.values + FIRST_STATE;
    Seen was, is;
    Rules after;
    int first = -1;
    if (watch_relations(self, &was) != OK) return fail(self);
    int by[ROOM(NX)] = {0}; /* the event that gives a state its value, and 1 */
    for (int i = N_EVENTS; i-- > 0;) {
        if (!risen[i]) continue;
        first = i;
        for (int k = events[i].first; k < events[i].first + events[i].count; k++) {
            if (!isfinite(rules->values[k]))
                return refuse(self, ERROR, "'%s' gives %s no finite value at %.12g s",
                              events[i].name, variables[FIRST_STATE + assigned[k]].name,
                              self->state.values[TIME]);
            if (by[assigned[k]] && x[assigned[k]] != rules->values[k])
                return refuse(self, ERROR, "'%s' and '%s' give %s different values at %.12g s",
                              events[i].name, events[by[assigned[k]] - 1].name,
                              variables[FIRST_STATE + assigned[k]].name, self->state.values[TIME]);
            by[assigned[k]] = i + 1;
            x[assigned[k]] = rules->values[k];
        }
    }
    self->state.stale |= AFTER_START;
    if (watch_relations(self, &is) != OK || evaluate_rules(self, &after) != OK) return fail(self);
    if (after.defect > 1e-6 && after.defect > 10 * rules->defect)
        return refuse(self, ERROR,
                      "'%s' at %.12g s leaves states that violate a constraint by %.2g; assign "
                      "consistent values",
                      events[first].name, self->state.values[TIME], after.defect);
    for (int i = 0; i < N_MODES; i++) {
        const bool same = is.arguments[i] == was.arguments[i];
        zero[i] = same && (zero[i] || s->slides[i] > 0);
        if (s->slides[i] > 0) {
            s->slides[i] = 0;
            self->state.values[FIRST_MODE + i] = self->state.values[FIRST_MODE + i] < 0 ? -1 : 1;
            self->state.stale |= AFTER_START;
        }
        if (!same) s->offsets[i] = 0;
    }
    return OK;
}

/* Let events happen until no condition rises. `name`: the last one. */
static Status iterate(Instance *self, bool zero[], const char **name, Outcome *outcome) {
    const bool decided[ROOM(N_MODES)] = {0};
    for (int round = 0;; round++) {
        Rules rules;
        bool risen[ROOM(N_EVENTS)];
        if (evaluate_rules(self, &rules) != OK) return fail(self);
        const int first = first_risen(self->state.switching.conditions, rules.conditions, risen);
        memcpy(self->state.switching.conditions, rules.conditions, N_EVENTS * sizeof(double));
        if (first < 0) return OK;
        *name = events[first].name;
        for (int i = 0; i < N_EVENTS; i++)
            if (risen[i])
                log_text(self, OK, "at %.17g s: %s", self->state.values[TIME], events[i].name);
        if (round == MOST_ROUNDS)
            return refuse(self, ERROR,
                          "'%s' happens again and again at %.12g s, more than %d times", *name,
                          self->state.values[TIME], MOST_ROUNDS);
        Status status = assign(self, &rules, risen, zero);
        if (status == OK) status = settle_modes(self, zero, decided, ERROR);
        if (status != OK) return status;
        for (int i = 0; i < N_EVENTS && !outcome->ends; i++)
            if (risen[i] && events[i].message) {
                outcome->ends = true;
                log_text(self, WARNING, "the run ends at %.12g s: %s", self->state.values[TIME],
                         events[i].message);
            }
        if (!outcome->ends) continue;
        self->state.switching.stopped = 1;
        return OK;
    }
}

static Status reject_zeno(Instance *self, const char *name, double way) {
    Switching *s = &self->state.switching;
    const double t = self->state.values[TIME];
    const bool near = t - s->last < CLOSE * fmax(1, fabs(t));
    s->close = near || (way > 0 && way < NO_WAY) ? s->close + 1 : 0;
    s->last = t;
    if (s->close <= MOST_CLOSE) return OK;
    return refuse(self, ERROR,
                  "'%s' happens ever faster before %.12g s (Zeno); end the run before with a stop "
                  "condition, or let the motion rest there",
                  name, t);
}

Status happen(Instance *self, int crossing, Outcome *outcome) {
    State *state = &self->state;
    Switching *s = &state->switching;
    const double *modes = state->values + FIRST_MODE;
    double x[ROOM(NX)], modes_before[ROOM(N_MODES)], way = 0;
    const double t = event_time(self);
    bool zero[ROOM(N_MODES)] = {0}, decided[ROOM(N_MODES)] = {0};
    *outcome = (Outcome){.ends = s->stopped > 0};
    if (outcome->ends) return OK;
    memcpy(x, state->values + FIRST_STATE, NX * sizeof *x);
    memcpy(modes_before, modes, N_MODES * sizeof *modes);
    if (find_switched(self, crossing, zero, decided, &way) != OK) return fail(self);
    Status status = settle_modes(self, zero, decided, ERROR);
    const char *name = NULL;
    if (status == OK) status = iterate(self, zero, &name, outcome);
    if (status != OK) return status;

    bool replan = !(s->next > t);
    const char *switched = NULL;
    for (int i = 0; i < N_MODES; i++) {
        if (modes[i] == modes_before[i]) continue;
        replan |= relations[i].of_time;
        if (!switched || relations[i].in_equations) switched = relations[i].name;
        if (!name && relations[i].in_equations) log_text(self, OK, "at %.17g s: %s", t, switched);
    }
    if (!name) name = switched;
    if (replan) plan_time_events(self, t);
    outcome->states_changed = memcmp(x, state->values + FIRST_STATE, NX * sizeof *x) != 0;
    return name ? reject_zeno(self, name, way) : OK;
}

bool event_waits(const Instance *self) {
    return self->state.switching.waits > 0;
}

bool leave_to_importer(Instance *self, int crossing) {
    Switching *s = &self->state.switching;
    const double t = self->state.values[TIME];
    if (!self->host.event_mode || !self->host.may_return_early) return false;
    bool due = crossing >= 0; /* ends of parts of a pulse are no events to others */
    for (int i = 0; i < N_MODES; i++) due |= relations[i].of_time && is_due(s, i, t);
    if (due) s->waits = 2 + crossing;
    return due;
}

int take_waiting(Instance *self) {
    const double waits = self->state.switching.waits;
    self->state.switching.waits = 0;
    return waits > 0 ? (int)waits - 2 : -1;
}

/* What inputs and parameters that have just been set make happen. */
bool start_over(Instance *self) {
    double inside[ROOM(N_WATCHED)];
    Outcome outcome = {.ends = run_stopped(self)};
    if (outcome.ends || get_insides(self, inside) != OK) return false;
    bool any = next_event(self) == NOT_PLANNED || event_waits(self);
    for (int i = 0; i < N_WATCHED; i++) any |= inside[i] < 0;
    if (any && happen(self, take_waiting(self), &outcome) != OK) return false;
    return !outcome.ends && refresh(self, ALGEBRAICS) == OK;
}

#else
typedef int no_events; /* C knows no empty file */
#endif
