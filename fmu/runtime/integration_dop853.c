/* Co-simulation by the pair of dop853.h, whose steps do not end at communication points.

   A step goes on beyond a communication point where the inputs rest, and an interpolant gives the
   states there: so neither the work nor the result depends on the communication step. Inputs that
   move, or have just been changed, end a step at the communication point.

   A step in which a relation leaves its mode ends exactly there, as does one at a time event. */
#include "integration.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "dop853_coefficients.h"
#include "equations.h"
#include "evaluation.h"
#include "events.h"
#include "input_motion.h"
#include "midway.h"
#include "rank.h"

/* Errors of steps add up, and the order is high: a hundredth of the requested tolerance in each
   step costs 1.8 times the right-hand sides, and brings the error of a run near the tolerance. */
static const double OF_TOLERANCE = 0.01;
static const double TIGHTEST = 1e-13;                 /* about 500 rounding errors */
static const double OF_ROUNDING = 1e-4 * DBL_EPSILON; /* of times on which laws depend */
static const double ABSOLUTE = 0.01;                  /* what is allowed at 0, in nominal values */

typedef struct {
    Instance *fmu;
    SolverMemory *memory; /* where a step begins, and its interpolant */
    Ode ode;
    double tolerance, z[ROOM(NZ)];
    int trials; /* of steps that are left: MOST_TRIALS of model.h bound the time of a call */
    Slopes k;
    double fresh[NX], fresh_error; /* the end of the last fresh step, and its error */
} Stepper;

/* dx/dt; the algebraic unknowns are solved from their last values. */
static int stepper_slope(void *stepper, double t, const double *x, double *dx) {
    Stepper *self = stepper;
    Instance *fmu = self->fmu;
    double u[ROOM(NU)] = {0};
    inputs_at(fmu, t, u);
#if HAS_EVENTS
    const Point at = {t, x, self->z, u};
    if (!follow_at(fmu, &at)) return 1;
#endif
    if (!solve_point(fmu, &t, x, self->z, u)) return 1;
    fmu->res[0] = dx;
    return model_ode(fmu->arg, fmu->res, fmu->iw, fmu->w, 0);
}

static double stepper_scale(const void *stepper, int i, double x) {
    const Stepper *self = stepper;
    const VariableInfo *state = &variables[FIRST_STATE + i];
    const double absolute = ABSOLUTE * state->nominal, size = fabs(x);
    /* what grows from a small value in proportion to it needs the digits of that */
    const bool low = state->rests_at_zero && size > 0 && size < absolute * sqrt(self->tolerance);
    return self->tolerance * (low ? size + DBL_MIN / DBL_EPSILON : absolute + size);
}

#if HAS_RANK
static const double POOR = 0.5; /* distance from a singular configuration, 1 at best */

/* The middle of the widest gap between the nodes of the stages. */
static const double GAP = 7.0 / 15;

static double distance_at(Stepper *self, double t, const double *x, double *rate) {
    Instance *fmu = self->fmu;
    double u[ROOM(NU)] = {0};
    inputs_at(fmu, t, u);
    pass_point(fmu, &t, x, self->z, u);
    return rank_at(fmu, rate);
}

/* What is left until the constraints lose rank, by their rate; infinite where that is far. */
static double time_to_loss(Stepper *self, double t, const double *x) {
    double rate = 0;
    if (distance_at(self, t, x, NULL) >= POOR) return INFINITY;
    const double distance = distance_at(self, t, x, &rate);
    return rate < 0 ? -distance / rate : INFINITY;
}

/* Move the end of a step to where the constraints hold, if they are poor there; false where that
   cannot be, or rank is lost. */
static bool keep_to_constraints(Stepper *self, double t, double *x) {
    double u[ROOM(NU)] = {0};
    inputs_at(self->fmu, t, u);
    const double distance = distance_at(self, t, x, NULL);
    return distance >= POOR || (distance >= LEAST_RANK && keep_constraints(self->fmu, t, u, x));
}
#else
#define time_to_loss(self, t, x) ((void)(self), (void)(t), (void)(x), INFINITY)
#define keep_to_constraints(self, t, x) ((void)(self), (void)(t), (void)(x), true)
static const double GAP = 1;
#endif

/* The size of a step near a singular configuration, where no evaluation should be: either the
   configuration falls into the gap between two stages, or the step ends well before it. */
static double size_before(double loss, double size) {
    if (loss == INFINITY) return size;
    return loss <= GAP * size ? loss / GAP : fmin(size, loss / 2);
}

/* Shorter ones are lost in rounding. */
static double shortest_step(double t, double length) {
    return 10 * DBL_EPSILON * fmax(fabs(t), length);
}

static void open_stepper(Stepper *self, Instance *fmu, SolverMemory *memory, double tolerance) {
    self->fmu = fmu;
    self->memory = memory;
    self->ode = (Ode){stepper_slope, stepper_scale, self};
    self->tolerance = tolerance;
    self->trials = MOST_TRIALS;
    memcpy(self->z, fmu->state.values + FIRST_ALGEBRAIC, NZ * sizeof *self->z);
}

/* Start from the instance's own state. */
static bool begin_motion(Stepper *self, double ahead) {
    SolverMemory *memory = self->memory;
    const double *values = self->fmu->state.values;
    memory->until = values[TIME];
#if HAS_EVENTS
    memory->crossing = 0;
#endif
    for (int i = 0; i < N_LIMITS; i++) memory->leaves[i] = DBL_MAX;
    memcpy(memory->end, values + FIRST_STATE, sizeof memory->end);
    if (slope(&self->ode, memory->until, memory->end, self->k[0]) || !is_finite(self->k[0]))
        return false;
    memcpy(memory->slope, self->k[0], sizeof memory->slope);
    if (memory->next > 0) return true;
    const double rest = ahead - memory->until;
    const double span =
        rest > shortest_step(memory->until, 0) ? fmin(rest, LARGEST_STEP) : LARGEST_STEP;
    memory->next = first_step(&self->ode, memory->until, span, memory->end, self->k);
    return true;
}

static void within_step(void *stepper, double t, double x[], double z[], double u[]) {
    const Stepper *self = stepper;
    evaluate(&self->memory->piece, t, x);
    memcpy(z, self->z, NZ * sizeof *z);
    inputs_at(self->fmu, t, u);
}

static void box_of_step(void *stepper, double low[], double high[]) {
    const Stepper *self = stepper;
    box_of(&self->memory->piece, low, high);
}

/* Note when an accepted step leaves limits, where it has an interpolant. */
static void look_at_limits(Stepper *self, double after) {
    const Motion motion = {.solver = self, .at = within_step, .box = box_of_step};
    find_leaving(self->fmu, &motion, self->memory->until, after, self->memory->leaves);
}

#if HAS_EVENTS
static bool step_again(void *stepper, double t, double x[], double z[], double u[]) {
    Stepper *self = stepper;
    const SolverMemory *memory = self->memory;
    if (fresh_step(&self->ode, memory->until, t, memory->end, self->k, self->fresh,
                   &self->fresh_error) ||
        !keep_to_constraints(self, t, self->fresh))
        return false;
    memcpy(x, self->fresh, sizeof self->fresh);
    memcpy(z, self->z, NZ * sizeof *z);
    inputs_at(self->fmu, t, u);
    return true;
}

/* End an accepted step from `until` to `after` at x where a relation leaves its mode. False where
   the last fresh step is not accurate, as what happens just before the crossing was stepped over.
 */
static bool end_at_crossing(Stepper *self, double *after, double x[]) {
    SolverMemory *memory = self->memory;
    const Motion motion = {.solver = self, .at = within_step, .step_to = step_again};
    Crossing crossing;
    memory->crossing = 0;
    if (!find_event(self->fmu, &motion, memory->until, *after, &crossing)) return false;
    if (crossing.relation < 0) return true;
    if (!(self->fresh_error <= 1)) return false;
    memcpy(x, self->fresh, sizeof self->fresh);
    memory->crossing = crossing.relation + 1;
    memory->since = crossing.since;
    *after = crossing.time;
    return true;
}
#else
#define end_at_crossing(self, after, x) true
#endif

/* One step on from the end of the last, no further than `ahead`; it may end beyond `end`. */
static bool take_step(Stepper *self, double end, double ahead) {
    SolverMemory *memory = self->memory;
    const Ode *ode = &self->ode;
    double x[NX], after;
    const double began = self->fmu->state.values[TIME];
    const double t = memory->until, shortest = shortest_step(t, end - began);
    if (ahead - t <= shortest) { /* as from a sample to a communication point: a line in time */
        memory->until = fmin(ahead, end);
        move_along(memory->end, memory->slope, memory->until - t, memory->end);
        return self->trials-- > 0;
    }
    note_leaving(self->fmu, t, memory->leaves); /* a communication point may lie within the last */
    const double loss = time_to_loss(self, t, memory->end);
    memcpy(self->k[0], memory->slope, sizeof self->k[0]);
    for (int rejected = 0; memory->next > shortest && self->trials-- > 0; rejected = 1) {
        const double size = size_before(loss, memory->next);
        const double most = loss < size ? 1 / OF_TOLERANCE : 1; /* the requested tolerance itself */
        const double error = try_step(ode, t, size, ahead, memory->end, self->k, &after, x);
        const double h = after - t;
        if (!(error <= most) || !keep_to_constraints(self, after, x) ||
            slope(ode, after, x, self->k[END]) || !is_finite(self->k[END])) {
            memory->next = smaller_size(h, error, rejected);
            continue;
        }
        const bool final = after == ahead;
        const bool needed = HAS_EVENTS || after > end;
        const bool dense = (needed || N_LIMITS > 0) &&
                           !interpolate(ode, t, h, memory->end, x, self->k, &memory->piece) &&
                           all_finite(memory->piece.row[0], 8 * NX);
        if (!dense) memset(&memory->piece, 0, sizeof memory->piece);
        if (needed && !dense) {
            if (after > end)
                ahead = end;
            else
                memory->next = 0.1 * h;
            continue;
        }
        if (!end_at_crossing(self, &after, x)) {
            memory->next = 0.1 * h;
            continue;
        }
        if (N_LIMITS > 0 && dense) look_at_limits(self, after);
        const double next = h * growth(error, rejected);
        const bool shortened = final || size < memory->next;
        memory->next = fmin(shortened ? fmax(memory->next, next) : next, LARGEST_STEP);
        memory->until = after;
        memcpy(memory->end, x, sizeof x);
        memcpy(memory->slope, self->k[END], sizeof memory->slope);
        return true;
    }
    memory->next = 0;
    return false;
}

/* Move the instance to a time that has been reached. */
static void move_to(const Stepper *self, double time) {
    SolverMemory *memory = self->memory;
    State *state = &self->fmu->state;
    double *values = state->values;
    if (time < memory->until)
        evaluate(&memory->piece, time, values + FIRST_STATE);
    else
        memcpy(values + FIRST_STATE, memory->end, sizeof memory->end);
    memcpy(values + FIRST_ALGEBRAIC, self->z, NZ * sizeof *values);
    move_inputs(self->fmu, time);
    state->stale |= AFTER_START;
    note_leaving(self->fmu, time, memory->leaves);
}

/* The end of a step within a communication step: an intermediate update that changes nothing. */
static bool show(const Stepper *self, double *end) {
    SolverMemory *memory = self->memory;
    State *state = &self->fmu->state;
    if (N_LIMITS == 0 && !self->fmu->host.step_finished) return true;
    State before = *state;
    move_to(self, memory->until);
    const bool well = pass_midway(self->fmu, end);
    before.mode = state->mode;
    before.violated = state->violated;
    memcpy(before.outside, state->outside, sizeof before.outside);
    memcpy(before.memory.leaves, memory->leaves, sizeof memory->leaves);
    memcpy(before.widest, state->widest, sizeof before.widest);
    memcpy(before.left, state->left, sizeof before.left);
    *state = before;
    return well;
}

#if HAS_EVENTS
enum { WENT_ON, HAPPENED, WAITS, FAILED };

/* All that happens where the last step ended, if anything does; then the solver starts afresh. */
static int pass_event(Stepper *self, double end, double ahead) {
    Instance *fmu = self->fmu;
    SolverMemory *memory = self->memory;
    if (memory->crossing == 0 && next_event(fmu) > memory->until) return WENT_ON;
    Outcome outcome;
    move_to(self, memory->until);
    if (leave_to_importer(fmu, (int)memory->crossing - 1)) {
        memset(memory, 0, sizeof *memory);
        return WAITS;
    }
    if (memory->until >= end) remember_instant(fmu);
    if (handle_instant(fmu, (int)memory->crossing - 1, &outcome) != OK || outcome.ends)
        return FAILED;
    if (refresh(fmu, ALGEBRAICS) != OK) return FAILED;
    memcpy(self->z, fmu->state.values + FIRST_ALGEBRAIC, NZ * sizeof *self->z);
    memcpy(memory->inputs, fmu->state.values + FIRST_INPUT, NU * sizeof *memory->inputs);
    memory->next = 0;
    return begin_motion(self, ahead) ? HAPPENED : FAILED;
}
#endif

void restart_solver(Instance *self) {
    self->state.memory.next = 0;
}

double typical_step(Instance *self) {
    SolverMemory memory = self->state.memory;
    Stepper stepper;
    open_stepper(&stepper, self, &memory, TIGHTEST);
    if (memory.next > 0 || begin_motion(&stepper, self->state.stop_time)) return memory.next;
    return LARGEST_STEP;
}

bool integrate_to(Instance *self, double end) {
    const State *state = &self->state;
    const double *u = state->values + FIRST_INPUT;
    SolverMemory *memory = &self->state.memory;
    const bool resting = inputs_rest(self);
    const bool first = !(memory->next > 0);
    const bool same =
        first || (memcmp(memory->inputs, u, (NU - MODES) * sizeof *u) == 0 && !self->state.retuned);
    self->state.retuned = false;
    const double ahead = resting && same ? fmax(state->stop_time, end) : end;
    const bool goes_on = !first && resting && same && memory->rested > 0;
#if HAS_EVENTS
    if (!goes_on && !start_over(self)) return false;
    if (event_waits(self)) return true;
#endif
    if (refresh(self, ALGEBRAICS) != OK) return false; /* the guess must be a solution */
    Stepper stepper;
    const double rounding = resting && !LAWS_OF_TIME ? 0 : OF_ROUNDING * fabs(end) / LARGEST_STEP;
    const double least = fmax(TIGHTEST, rounding);
    open_stepper(&stepper, self, memory, fmax(OF_TOLERANCE * state->tolerance, least));
    if (!goes_on && !begin_motion(&stepper, ahead)) {
        memset(memory, 0, sizeof *memory);
        return false;
    }
    memory->rested = resting;
    memcpy(memory->inputs, u, NU * sizeof *u);
    /* the end of a step that was made in an earlier communication step */
    const bool passes = memory->until > state->values[TIME] && memory->until < end;
    if (passes && self->host.step_finished && !show(&stepper, &end)) return false;

    for (;;) {
        double until = ahead;
#if HAS_EVENTS
        end = end_with_event(self, end);
        if (memory->crossing > 0 && memory->since <= end) end = fmax(end, memory->until);
        if (memory->crossing > 0) memory->until = end_if_only_rounding(self, memory->until, end);
        const int how = memory->until <= end ? pass_event(&stepper, end, ahead) : WENT_ON;
        if (how == FAILED) return false;
        if (how == WAITS) return true;
        if (how == HAPPENED) continue;
        until = fmin(fmax(ahead, end), event_before(self, end));
#endif
        if (memory->until >= end) break;
        if (!take_step(&stepper, end, until) || (memory->until < end && !show(&stepper, &end))) {
            move_to(&stepper, memory->until);
            return false;
        }
    }
    move_to(&stepper, end);
    return true;
}
