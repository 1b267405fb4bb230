/* The laws of a model for the kernel of events, and the relations of an instance. */
#include "modes.h"

#include "equations.h"
#include "input_motion.h"
#include "logging.h"

#if HAS_EVENTS

/* -- the model's laws ------------------------------------------------------------------------- */

Point present(Instance *self) {
    double *values = self->state.values;
    return (Point){values[TIME], values + FIRST_STATE, values + FIRST_ALGEBRAIC,
                   values + FIRST_INPUT};
}

static const ModelLaws model_laws = MODEL_LAWS;

Laws laws_of(Instance *self) {
    Laws laws = laws_of_model(&self->laws);
    laws.blind = self->state.interface == INTERFACE_ME;
    laws.set = laws.blind && (self->state.stale & SIDES);
    return laws;
}

/* Why the kernel cannot go on, and the remedy; the native simulation has its texts from here. */
#define TEXTS_OF_ENDINGS(X)                                                                        \
    X(NO_VALUE, "the equations have no value at the event at %.12g s", t)                          \
    X(NO_MODES, "no consistent modes at %.12g s (%s); use a smooth law such as tanh there", t,     \
      relation)                                                                                    \
    X(TOO_MANY_ROUNDS,                                                                             \
      "'%s' happens again and again at %.12g s, more than 100 times; let its assignments make "    \
      "its condition false",                                                                       \
      rule, t)                                                                                     \
    X(TOO_CLOSE,                                                                                   \
      "'%s' happens ever faster before %.12g s (Zeno); end the run before with a stop condition, " \
      "or let the motion rest there",                                                              \
      rule, t)                                                                                     \
    X(CONTRADICTS,                                                                                 \
      "'%s' and '%s' give %s different values at %.12g s; make one event of them, or conditions "  \
      "that exclude each other",                                                                   \
      other, rule, state, t)                                                                       \
    X(NOT_FINITE_ASSIGNED, "'%s' gives %s no finite value at %.12g s; assign a finite one", rule,  \
      state, t)                                                                                    \
    X(VIOLATES,                                                                                    \
      "'%s' at %.12g s leaves states that violate: %s (by %.2g); assign consistent values", rule,  \
      t, violated, size)                                                                           \
    X(STAYS_TRUE,                                                                                  \
      "the condition of '%s' stays true after %.12g s, so that it cannot happen again; let the "   \
      "motion rest there by a mode or a contact",                                                  \
      rule, t)

/* Refuse what the kernel cannot go on from. */
Status refuse_ending(Instance *self, Status severity, const Ending *why, const char *switched) {
    const double t = self->state.values[TIME], size = why->size;
    const bool of_modes = why->reason == NO_MODES;
    const char *relation = of_modes ? relation_names[why->part] : "";
    const char *rule = why->part >= 0 && !of_modes ? rule_names[why->part] : switched;
    const char *other = why->reason == CONTRADICTS ? rule_names[why->other] : "";
    const char *state = why->state >= 0 ? variables[FIRST_STATE + why->state].name : "";
    const char *violated = "a constraint";
#define CASE(reason, ...)                                                                          \
    case reason: return refuse(self, severity, __VA_ARGS__);
    switch (why->reason) {
        TEXTS_OF_ENDINGS(CASE)
    default: return OK;
    }
}

/* -- the present modes ------------------------------------------------------------------------ */

Status start_modes(Instance *self) {
    State *state = &self->state;
    const Laws laws = laws_of(self);
    const Point at = present(self);
    const double rest = state->stop_time - state->values[TIME], span = SPAN * LARGEST_STEP;
    const Ending found = begin_modes(&laws, &state->switching, &at, rest < INFINITY ? rest : span);
    state->switching.last = state->values[TIME];
    state->stale |= AFTER_START;
    return refuse_ending(self, DISCARD, &found, NULL);
}

void take_sides(Instance *self) {
    State *state = &self->state;
    Aside *aside = &state->aside;
    if (!(state->stale & SIDES) || state->mode != STEP_MODE || self->host.event_mode) return;
    state->stale &= ~(uint32_t)SIDES;
    if (state->switching.stopped > 0) return;
    const Laws laws = laws_of(self);
    const Point at = present(self);
    double motion[MOST_INPUT_ORDER][ROOM(NU)], *modes = state->values + FIRST_MODE;
    memcpy(motion, state->motion, sizeof motion);
    if (state->motion_spent) memset(state->motion, 0, sizeof motion);
    redo_instant(self);
    aside->known = 1;
    aside->switching = state->switching;
    memcpy(aside->modes, modes, MODES * sizeof *modes);
    const Ending found = settle_by_value(&laws, &state->switching, &at);
    memcpy(state->motion, motion, sizeof motion);
    if (found.reason != GOES_ON) leave_sides(self); /* the next step tells */
}

void leave_sides(Instance *self) {
    State *state = &self->state;
    if (state->aside.known == 0) return;
    state->aside.known = 0;
    state->switching = state->aside.switching;
    memcpy(state->values + FIRST_MODE, state->aside.modes, MODES * sizeof *state->values);
    state->stale |= AFTER_START | SIDES;
}

Status follow_present(Instance *self) {
    const Point at = present(self);
    if (follow_at(self, &at)) return OK;
    return refuse(self, DISCARD, "no mode keeps an expression at 0 that slides there at time %.17g",
                  at.t);
}

bool follow_at(Instance *self, const Point *at) {
    const Laws laws = laws_of(self);
    return follow(&laws, &self->state.switching, at);
}

/* The relations at the present values. */
Status look_now(Instance *self, Seen *seen) {
    const Point at = present(self);
    const Status status = follow_present(self);
    if (status != OK || law_see(&self->laws, &at, seen)) return status;
    return refuse(self, DISCARD, "the relations cannot be computed at time %.17g", at.t);
}

/* Whether an input has moved an argument that slides, or has kept one at 0 that all others have
 * moved since its event. Importers of model exchange do not tell the rates of inputs. */
static bool is_kept_by_inputs(const Laws *laws, const Switching *s, const Seen *seen, int i,
                              double t) {
    const double way = fabs(seen->rates[i]) * (t - s->last);
    if (s->state[i] == SLIDES) return is_moved(laws, s, seen, i);
    return s->state[i] == LEAVES && laws->relations[i].moved && way > MOVED * s->slack[i] &&
           fabs(past_boundary(laws, s, seen, i)) < way / 1000;
}

Status complete_step(Instance *self, Status severity) {
    Switching *s = &self->state.switching;
    const Laws laws = laws_of(self);
    const bool any = any_is(s, LEAVES) || any_is(s, SLIDES);
    Seen seen;
    const Status status = any ? look_now(self, &seen) : OK;
    if (!any || status != OK) return status;
    for (int i = 0; i < MODES && laws.blind; i++)
        if (is_kept_by_inputs(&laws, s, &seen, i, self->state.values[TIME]))
            return refuse(self, severity,
                          "an input moves '%s', which stays 0, at %.12g s, and model exchange does "
                          "not tell its rate: use co-simulation, or compute it in the model",
                          relation_names[i], self->state.values[TIME]);
    note_inside(&laws, s, self->state.values + FIRST_MODE, seen.arguments);
    return OK;
}

Status get_insides(Instance *self, double inside[]) {
    Seen seen;
    const Status status = look_now(self, &seen);
    if (status != OK) return status;
    const Laws laws = laws_of(self);
    const Point at = present(self);
    Switching *s = &self->state.switching;
    const double *values = self->state.values;
    double all[ROOM(MODES)], rates[ROOM(MODES)];
    Spread spread;
    /* an importer that goes back locates an event; solvers of co-simulation note their own looks */
    const bool ends = values[TIME] >= s->looked;
    if (laws.blind) {
        note_least(&laws, s, &at, &spread);
        s->rounded += values[TIME] > s->looked;
        s->looked = fmax(values[TIME], s->looked);
        self->state.stale &= ~(uint32_t)SIDES;
    }
    measure(&laws, s, values + FIRST_MODE, &seen, all, rates);
    for (int i = 0, k = 0; i < MODES; i++) {
        if (relation_table[i].of_time) continue;
        const bool passing = is_passing(s, values[TIME], i, all[i], rates[i], ends);
        inside[k++] = passing ? fmin(all[i], -s->slack[i]) : all[i];
    }
    return OK;
}

/* -- within a step ---------------------------------------------------------------------------- */

typedef struct {
    Instance *fmu;
    Laws laws;
    const Motion *motion;
    const Off *off; /* by how much the motion may be off; NULL: by nothing */
    bool proven;    /* by bounds, that no relation with these leaves its mode in the whole step */
} SearchedStep;

static void look_at(void *step, double t, Place *found) {
    SearchedStep *self = step;
    double x[ROOM(NX)], z[ROOM(NZ)] = {0}, u[ROOM(NU)];
    self->motion->at(self->motion->solver, t, x, z, u);
    margins_at(&self->laws, &self->fmu->state.switching, &(Point){t, x, z, u}, found);
}

static bool step_afresh(void *step, double t, Place *found) {
    SearchedStep *self = step;
    double x[ROOM(NX)], z[ROOM(NZ)] = {0}, u[ROOM(NU)];
    return self->motion->step_to(self->motion->solver, t, x, z, u) &&
           margins_at(&self->laws, &self->fmu->state.switching, &(Point){t, x, z, u}, found);
}

static bool stays(void *step, const Place *a, const Place *b) {
    SearchedStep *self = step;
    const Motion *motion = self->motion;
    double z[ROOM(NZ)] = {0};
    Sample samples[NODES];
    if (ENCLOSED == 0 || self->proven) return true;
    for (int k = 0; k < NODES; k++)
        motion->at(motion->solver, node_between(a->t, b->t, k), samples[k], z, samples[k] + NX);
    const Point at = {a->t, samples[0], z, samples[0] + NX};
    return sampled_stays_within(&self->laws, &self->fmu->state.switching, &at, b->t - a->t,
                                (const Sample *)samples, self->off, a->inside, b->inside);
}

/* Boundaries that an event has displaced are where they were as soon as a step ends within them. */
static void let_go(SearchedStep *self, double end) {
    Switching *s = &self->fmu->state.switching;
    double x[ROOM(NX)], z[ROOM(NZ)] = {0}, u[ROOM(NU)];
    Seen seen;
    if (!any_is(s, LEAVES)) return;
    self->motion->at(self->motion->solver, end, x, z, u);
    const Point at = {end, x, z, u};
    if (look_closely(&self->laws, s, &at, &seen))
        note_inside(&self->laws, s, modes_of(&at), seen.arguments);
}

#if FIXED_STEPS > 0
/* Whether bounds prove that no relation leaves its mode in a whole step. */
static bool is_quiet(SearchedStep *self, const Point *at, const Place *a, const Place *b) {
    const Motion *motion = self->motion;
    const double length = b->t - a->t;
    double x[ROOM(NX)], z[ROOM(NZ)];
    Sample samples[NODES];
    Spans spans;
    if (ENCLOSED == 0) return true;
    for (int k = 0; k < NODES; k++)
        motion->at(motion->solver, node_between(a->t, b->t, k), x, z, samples[k] + NX);
    for (int i = NX; i < NX + NU - MODES; i++)
        enclose_motion((const Sample *)samples, i, length, &spans);
    return stays_by_slopes(&self->laws, &self->fmu->state.switching, at, length, motion->stages,
                           FIXED_STEPS, &spans, a->inside, b->inside) ||
           stays_sharply(stays, self, motion->quintic, &self->off, a, b);
}
#endif

bool find_event(Instance *self, const Motion *motion, double begin, double end,
                Crossing *crossing) {
    SearchedStep step = {.fmu = self, .laws = laws_of(self), .motion = motion};
    Switching *s = &self->state.switching;
    const Beyond beyond = end >= s->next ? BY_EVENTS : inputs_rest(self) ? AS_IS : BUT_INPUTS;
    double x[ROOM(NX)], z[ROOM(NZ)] = {0}, u[ROOM(NU)];
    Place before;
    motion->at(motion->solver, begin, x, z, u);
    const Point at = {begin, x, z, u};
    note_slack(&step.laws, s, &at);
    margins_at(&step.laws, s, &at, &before);
    note_steps(s, end, 1);
#if FIXED_STEPS > 0
    Place after;
    look_at(&step, end, &after);
    step.proven =
        outside(&before) < 0 && outside(&after) < 0 && is_quiet(&step, &at, &before, &after);
    if (!step.proven || is_suspect(&step.laws, s, &before, &after, beyond))
        sharpen_fully(motion->quintic);
#endif
    const Located how = find_crossing(look_at, stays, step_afresh, &step, &step.laws, s, begin,
                                      before, end, beyond, crossing);
    if (how == CROSSES && crossing->relation < 0) let_go(&step, end);
    return how != FAILS;
}

int left_between(Instance *self, const Motion *motion, double begin, double end, Place *found) {
    SearchedStep step = {.fmu = self, .laws = laws_of(self), .motion = motion};
    Place before;
    look_at(&step, begin, &before);
    *found = before;
    return outside(&before) >= 0 ? -1 : crossing_between(look_at, stays, &step, before, end, found);
}

#else
typedef int no_modes; /* C knows no empty file */
#endif
