/* Events of an instance: what the kernel tells as messages, time events, and waiting importers. */
#include "events.h"

#include "evaluation.h"
#include "integration.h"
#include "logging.h"

#if HAS_EVENTS

#include "happen.h"
#include "plan.h"

/* -- messages --------------------------------------------------------------------------------- */

static const char *relation_that_switched(const Instance *self, const Happening *found) {
    const char *name = "an event";
    for (int i = MODES; i-- > 0;)
        if (self->state.values[FIRST_MODE + i] != found->modes[i]) name = relation_names[i];
    return name;
}

/* Tell which relations slide by what inputs do. */
static void log_sliding(const Instance *self) {
    for (int i = 0; i < MODES; i++)
        if (self->state.switching.state[i] == SLIDES && *relation_movers[i])
            log_text(self, OK, "from %.17g s on, '%s' stays 0 by %s", self->state.values[TIME],
                     relation_names[i], relation_movers[i]);
}

/* Tell what happened: the rules, or the relations of the equations that switched. */
static void log_happening(Instance *self, const Happening *found) {
    const double t = self->state.values[TIME];
    for (int k = 0; k < found->count; k++)
        log_text(self, OK, "at %.17g s: %s", t, rule_names[found->happened[k]]);
    for (int i = 0; found->count == 0 && i < MODES; i++)
        if (relation_table[i].in_laws && self->state.values[FIRST_MODE + i] != found->modes[i])
            log_text(self, OK, "at %.17g s: %s", t, relation_names[i]);
    if (found->ending.reason == STOPPED && found->ending.part >= 0)
        log_text(self, WARNING, "the run ends at %.12g s: %s", t,
                 rule_messages[found->ending.part]);
    log_sliding(self);
}

/* -- the start -------------------------------------------------------------------------------- */

Status start_events(Instance *self) {
    const Laws laws = laws_of(self);
    const Point at = present(self);
    const Ending found = begin_events(&laws, &self->state.switching, &at);
    if (found.reason == STOPPED)
        return refuse(self, ERROR,
                      "stop '%s' is true at the start already; give a condition that becomes true "
                      "later",
                      rule_messages[found.part]);
    log_sliding(self);
    return refuse_ending(self, ERROR, &found, NULL);
}

/* -- instants --------------------------------------------------------------------------------- */

static void plan_time_events(Instance *self, double now) {
    const Laws laws = laws_of(self);
    const Point at = present(self);
    const double far = now + SPAN * LARGEST_STEP, stop = self->state.stop_time;
    const double end = now < stop ? fmin(far, stop) : far;
    double pulse = NEVER_AGAIN;
    for (int k = N_PULSES; k-- > 0;)
        if (pulses[k] > now + 4 * DBL_EPSILON * fabs(now)) pulse = pulses[k];
    plan(&laws, &self->state.switching, &at, now, end, end == stop, pulse);
}

void enter_instant(Instance *self) {
    State *state = &self->state;
    const Laws laws = laws_of(self);
    const Point at = present(self);
    if (!(event_time(&laws, &state->switching, at.t) >= next_event(self))) return;
    state->before.known = 2;
    memcpy(state->before.modes, state->values + FIRST_MODE, MODES * sizeof *state->before.modes);
    modes_of_time(&laws, &at, fmax(at.t, next_event(self)), state->values + FIRST_MODE);
    state->stale |= AFTER_START;
}

void leave_instant(Instance *self) {
    State *state = &self->state;
    if (state->before.known != 2) return;
    state->before.known = 0;
    memcpy(state->values + FIRST_MODE, state->before.modes, MODES * sizeof *state->before.modes);
    state->stale |= AFTER_START;
}

Status handle_instant(Instance *self, int crossing, Outcome *outcome) {
    leave_instant(self);
    State *state = &self->state;
    const Laws laws = laws_of(self);
    const Point at = present(self);
    const bool stopped = run_stopped(self);
    const double t = event_time(&laws, &state->switching, at.t);
    const bool later[ROOM(MODES)] = {0};
    state->switching.looked = nextafter(at.t, INFINITY); /* all before it is decided here */
    Happening found;
    bool replan;
    happen(&laws, &state->switching, &at, state->values + FIRST_STATE, crossing, later, NULL,
           &found, &replan);
    *outcome = (Outcome){found.states_changed, found.ending.reason == STOPPED};
    if (stopped) return OK;
    state->stale |= AFTER_START;
    if (state->before.known >= 0) log_happening(self, &found); /* again is once */
    if (found.states_changed || found.modes_changed) restart_solver(self);
    const Status status =
        refuse_ending(self, ERROR, &found.ending, relation_that_switched(self, &found));
    if (replan && status == OK) plan_time_events(self, t);
    return status;
}

/* -- time events, and co-simulation ----------------------------------------------------------- */

double next_event(const Instance *self) {
    return self->state.switching.next;
}

/* Whether only rounding is between the next time event and the end of a step: an importer that adds
   its steps rounds the time in each of them. */
static bool is_at_end(const Instance *self, double end) {
    const double step = end - self->state.values[TIME];
    const double largest = largest_time(&self->state.switching, end);
    const double rounding = (8 + self->state.steps) * DBL_EPSILON * largest;
    return fabs(next_event(self) - end) <= fmin(rounding, step / 2);
}

double end_with_event(const Instance *self, double end) {
    return is_at_end(self, end) ? fmax(end, next_event(self)) : end;
}

double event_before(const Instance *self, double end) {
    return is_at_end(self, end) ? end : next_event(self);
}

double end_if_only_rounding(const Instance *self, double time, double end) {
    const Switching *s = &self->state.switching;
    const double rounding = located(s, end) * time_scale(s, end);
    return time < end && end - time <= rounding ? end : time;
}

bool run_stopped(const Instance *self) {
    return self->state.switching.stopped > 0;
}

void note_samples(Instance *self, double counts[]) {
    const Laws laws = laws_of(self);
    const Point at = present(self);
    samples_at(&laws, &self->state.switching, &at, counts);
}

void rebase_samples(Instance *self, const double counts[]) {
    const Laws laws = laws_of(self);
    const Point at = present(self);
    Switching *const both[] = {&self->state.switching, &self->state.before.switching};
    double now[ROOM(EVENTS)];
    samples_at(&laws, both[0], &at, now);
    for (int k = 0; k < 2; k++) {
        both[k]->next = NOT_PLANNED;
        for (int i = 0; i < EVENTS; i++)
            if (rule_table[i].sampled) both[k]->conditions[i] += now[i] - counts[i];
    }
}

bool event_waits(const Instance *self) {
    return self->state.switching.waits > 0;
}

bool leave_to_importer(Instance *self, int crossing) {
    Switching *s = &self->state.switching;
    const double t = self->state.values[TIME];
    if (!self->host.event_mode || !self->host.may_return_early) return false;
    bool due = crossing >= 0; /* ends of parts of a pulse are no events to others */
    for (int i = 0; i < MODES; i++) due |= relation_table[i].of_time && is_due(s, i, t);
    if (due) s->waits = 2 + crossing;
    return due;
}

int take_waiting(Instance *self) {
    const double waits = self->state.switching.waits;
    self->state.switching.waits = 0;
    return waits > 0 ? (int)waits - 2 : -1;
}

/* Whether a relation is beyond its mode, or rests on its boundary, where the value decides. One
   that moves on from there crosses within the step, which then ends for the importer. */
static bool any_due(Instance *self) {
    const Switching *s = &self->state.switching;
    const Laws laws = laws_of(self);
    double inside[ROOM(MODES)], rates[ROOM(MODES)];
    Seen seen;
    const Point at = present(self);
    if (!look_closely(&laws, s, &at, &seen)) return true;
    measure(&laws, s, self->state.values + FIRST_MODE, &seen, inside, rates);
    for (int i = 0; i < MODES; i++) {
        const double value = seen.arguments[i];
        if (inside[i] < 0) return true;
        if (value == (relation_table[i].floor ? round(value) : 0) && rates[i] == 0 &&
            s->state[i] != SLIDES && !is_held(&laws, s, &seen, i))
            return true;
    }
    return false;
}

void remember_instant(Instance *self) {
    State *state = &self->state;
    Before *before = &state->before;
    before->known = 1;
    before->time = state->values[TIME];
    before->switching = state->switching;
    memcpy(before->x, state->values + FIRST_STATE, NX * sizeof *before->x);
    memcpy(before->modes, state->values + FIRST_MODE, MODES * sizeof *before->modes);
    memcpy(before->inputs, state->values + FIRST_INPUT, (NU - MODES) * sizeof *before->inputs);
}

void keep_instant(Instance *self) {
    if (self->state.before.known != 2) self->state.before.known = 0;
}

/* Undo the event at a communication point if the importer has set other inputs there since: it
   happens with these. */
static bool undo_instant(Instance *self) {
    State *state = &self->state;
    const Before *before = &state->before;
    const double *inputs = state->values + FIRST_INPUT;
    if (before->known == 0 || before->time != state->values[TIME] ||
        (before->known == 1 && memcmp(before->inputs, inputs, (NU - MODES) * sizeof *inputs) == 0))
        return false;
    state->switching = before->switching;
    memcpy(state->values + FIRST_STATE, before->x, NX * sizeof *before->x);
    memcpy(state->values + FIRST_MODE, before->modes, MODES * sizeof *before->modes);
    state->stale |= AFTER_START;
    return true;
}

void redo_instant(Instance *self) {
    State *state = &self->state;
    const State before = *state;
    const uint32_t logged = self->categories;
    Outcome outcome;
    if (!undo_instant(self)) return;
    state->before.known = -1;
    self->categories = 0; /* the next step tells */
    const bool well = handle_instant(self, -1, &outcome) == OK;
    self->categories = logged;
    if (!well) *state = before;
    state->memory = before.memory;
    state->before.known = well ? 3 : before.before.known;
}

/* Leave what is due at the start of a step to the importer, unless it changes nothing. */
static bool leave_change_to_importer(Instance *self) {
    if (!self->host.event_mode || !self->host.may_return_early) return false;
    const State before = self->state;
    Outcome outcome;
    self->state.before.known = -1; /* tells nothing */
    const Status status = handle_instant(self, -1, &outcome);
    const State *after = &self->state;
    const bool changes =
        status == OK &&
        (outcome.states_changed || memcmp(before.values + FIRST_MODE, after->values + FIRST_MODE,
                                          MODES * sizeof *before.values) != 0);
    self->state = before;
    if (changes) self->state.switching.waits = 1;
    return changes;
}

bool start_over(Instance *self) {
    Outcome outcome = {.ends = run_stopped(self)};
    const bool again = !outcome.ends && undo_instant(self);
    self->state.before.known = again ? -1 : 0;
    if (outcome.ends) return false;
    const bool waits = event_waits(self), due = again || waits || next_event(self) == NOT_PLANNED;
    const bool beyond = !due && any_due(self);
    if (beyond && leave_change_to_importer(self)) return true;
    if ((due || beyond) && handle_instant(self, take_waiting(self), &outcome) != OK) return false;
    self->state.before.known = 0;
    return !outcome.ends && refresh(self, ALGEBRAICS) == OK;
}

#else
typedef int no_events; /* C knows no empty file */
#endif
