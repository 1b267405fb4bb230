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
static const double TIGHTEST = 1e-13; /* about 500 rounding errors */
static const double ABSOLUTE = 0.01;  /* what is allowed at 0, in nominal values */

typedef struct {
    Instance *fmu;
    double tolerance;
    double z[ROOM(NZ)];
    int trials; /* of steps that are left: MOST_TRIALS of model.h bound the time of a call */
} Problem;

/* dx/dt; the algebraic unknowns are solved from their last values. */
static int problem_slope(void *problem, double t, const double *x, double *dx) {
    Problem *self = problem;
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

static double problem_scale(const void *problem, int i, double x) {
    const Problem *self = problem;
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

static double distance_at(Problem *self, double t, const double *x, double *rate) {
    Instance *fmu = self->fmu;
    double u[ROOM(NU)] = {0};
    inputs_at(fmu, t, u);
    pass_point(fmu, &t, x, self->z, u);
    return rank_at(fmu, rate);
}

/* What is left until the constraints lose rank, by their rate; infinite where that is far. */
static double time_to_loss(Problem *self, double t, const double *x) {
    double rate = 0;
    if (distance_at(self, t, x, NULL) >= POOR) return INFINITY;
    const double distance = distance_at(self, t, x, &rate);
    return rate < 0 ? -distance / rate : INFINITY;
}

/* Move the end of a step to where the constraints hold, if they are poor there; false where that
   cannot be, or rank is lost. */
static bool keep_to_constraints(Problem *self, double t, double *x) {
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

/* Start from the instance's own state. */
static bool begin_motion(const Ode *ode, const Instance *fmu, SolverMemory *memory, double ahead) {
    const double *values = fmu->state.values;
    memory->until = values[TIME];
#if HAS_EVENTS
    memory->crossing = 0;
#endif
    for (int i = 0; i < N_LIMITS; i++) memory->leaves[i] = DBL_MAX;
    memcpy(memory->end, values + FIRST_STATE, sizeof memory->end);
    Slopes k;
    if (slope(ode, memory->until, memory->end, k[0]) || !is_finite(k[0])) return false;
    memcpy(memory->slope, k[0], sizeof memory->slope);
    if (memory->next > 0) return true;
    const double rest = ahead - memory->until;
    const double span =
        rest > shortest_step(memory->until, 0) ? fmin(rest, LARGEST_STEP) : LARGEST_STEP;
    memory->next = first_step(ode, memory->until, span, memory->end, k);
    return true;
}

typedef struct {
    const Ode *ode;
    Problem *problem;
    const SolverMemory *memory; /* where the step begins, and its interpolant */
    Slopes *k;
    double x[NX], error; /* of the last fresh step */
} Step;

static void within_step(void *step, double t, double x[], double z[], double u[]) {
    const Step *self = step;
    evaluate(&self->memory->piece, t, x);
    memcpy(z, self->problem->z, NZ * sizeof *z);
    inputs_at(self->problem->fmu, t, u);
}

static void box_of_step(void *step, double low[], double high[]) {
    const Step *self = step;
    box_of(&self->memory->piece, low, high);
}

/* Note when an accepted step leaves limits, where it has an interpolant. */
static void look_at_limits(Problem *self, SolverMemory *memory, double after) {
    Step made = {.problem = self, .memory = memory};
    const Motion motion = {.solver = &made, .at = within_step, .box = box_of_step};
    find_leaving(self->fmu, &motion, memory->until, after, memory->leaves);
}

#if HAS_EVENTS
static bool step_again(void *step, double t, double x[], double z[], double u[]) {
    Step *self = step;
    const double from = self->memory->until, *start = self->memory->end;
    memcpy(self->x, start, sizeof self->x);
    self->error = 0;
    if (t > from) {
        if (stages(self->ode, from, t - from, start, *self->k, self->x)) return false;
        self->error = error_of(self->ode, t - from, start, self->x, *self->k);
    }
    if (!keep_to_constraints(self->problem, t, self->x)) return false;
    memcpy(x, self->x, sizeof self->x);
    memcpy(z, self->problem->z, NZ * sizeof *z);
    inputs_at(self->problem->fmu, t, u);
    return true;
}

/* End an accepted step from `until` to `after` at x where a relation leaves its mode. False where
   the last fresh step is not accurate, as what happens just before the crossing was stepped over.
 */
static bool end_at_crossing(const Ode *ode, Problem *self, SolverMemory *memory, Slopes k,
                            double *after, double x[]) {
    Step last = {.ode = ode, .problem = self, .memory = memory, .k = (Slopes *)k};
    const Motion motion = {.solver = &last, .at = within_step, .step_to = step_again};
    Crossing crossing;
    memory->crossing = 0;
    const bool goes_on = memory->rested > 0 && *after < next_event(self->fmu);
    if (!find_event(self->fmu, &motion, memory->until, *after, goes_on, &crossing)) return false;
    if (crossing.relation < 0) return true;
    if (!(last.error <= 1)) return false;
    memcpy(x, last.x, sizeof last.x);
    memory->crossing = crossing.relation + 1;
    memory->since = crossing.since;
    *after = crossing.time;
    return true;
}
#else
#define end_at_crossing(ode, self, memory, k, after, x) true
#endif

/* One step on from the end of the last, no further than `ahead`; it may end beyond `end`. */
static bool take_step(const Ode *ode, Problem *self, SolverMemory *memory, double end,
                      double ahead) {
    Slopes k;
    double x[NX];
    const double began = self->fmu->state.values[TIME];
    const double t = memory->until, shortest = shortest_step(t, end - began);
    if (ahead - t <= shortest) { /* as from a sample to a communication point: nothing moves */
        memory->until = fmin(ahead, end);
        return self->trials-- > 0;
    }
    note_leaving(self->fmu, t, memory->leaves); /* a communication point may lie within the last */
    const double loss = time_to_loss(self, t, memory->end);
    memcpy(k[0], memory->slope, sizeof k[0]);
    for (int rejected = 0; memory->next > shortest && self->trials-- > 0; rejected = 1) {
        const double size = size_before(loss, memory->next);
        const double most = loss < size ? 1 / OF_TOLERANCE : 1; /* the requested tolerance itself */
        const bool final = t + 1.01 * size >= ahead;
        double after = final ? ahead : t + size;
        const double h = after - t; /* as time is rounded, so that states do not run away from it */
        const int lost = stages(ode, t, h, memory->end, k, x);
        const double error = lost ? NAN : error_of(ode, h, memory->end, x, k);
        if (!(error <= most) || !keep_to_constraints(self, after, x) ||
            slope(ode, after, x, k[END]) || !is_finite(k[END])) {
            memory->next = h * (error > 1 ? growth(error, rejected) : 0.1);
            continue;
        }
        const bool needed = HAS_EVENTS || after > end;
        const bool dense = (needed || N_LIMITS > 0) &&
                           !interpolate(ode, t, h, memory->end, x, k, &memory->piece) &&
                           all_finite(memory->piece.row[0], 8 * NX);
        if (!dense) memset(&memory->piece, 0, sizeof memory->piece);
        if (needed && !dense) {
            if (after > end)
                ahead = end;
            else
                memory->next = 0.1 * h;
            continue;
        }
        if (!end_at_crossing(ode, self, memory, k, &after, x)) {
            memory->next = 0.1 * h;
            continue;
        }
        if (N_LIMITS > 0 && dense) look_at_limits(self, memory, after);
        const double next = h * growth(error, rejected);
        const bool shortened = final || size < memory->next;
        memory->next = fmin(shortened ? fmax(memory->next, next) : next, LARGEST_STEP);
        memory->until = after;
        memcpy(memory->end, x, sizeof x);
        memcpy(memory->slope, k[END], sizeof memory->slope);
        return true;
    }
    memory->next = 0;
    return false;
}

/* Move the instance to a time that has been reached. */
static void move_to(const Problem *self, SolverMemory *memory, double time) {
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
static bool show(const Problem *self, SolverMemory *memory, double *end) {
    State *state = &self->fmu->state;
    if (N_LIMITS == 0 && !self->fmu->host.step_finished) return true;
    State before = *state;
    move_to(self, memory, memory->until);
    const bool well = pass_midway(self->fmu, end);
    before.mode = state->mode;
    before.outside = state->outside;
    memcpy(before.memory.leaves, memory->leaves, sizeof memory->leaves);
    memcpy(before.widest, state->widest, sizeof before.widest);
    memcpy(before.left, state->left, sizeof before.left);
    *state = before;
    return well;
}

#if HAS_EVENTS
enum { WENT_ON, HAPPENED, WAITS, FAILED };

/* All that happens where the last step ended, if anything does; then the solver starts afresh. */
static int pass_event(const Ode *ode, Problem *self, SolverMemory *memory, double end,
                      double ahead) {
    Instance *fmu = self->fmu;
    if (memory->crossing == 0 && next_event(fmu) > memory->until) return WENT_ON;
    Outcome outcome;
    move_to(self, memory, memory->until);
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
    return begin_motion(ode, fmu, memory, ahead) ? HAPPENED : FAILED;
}
#endif

void restart_solver(Instance *self) {
    self->state.memory.next = 0;
}

double typical_step(Instance *self) {
    SolverMemory memory = self->state.memory;
    Problem problem = {.fmu = self, .tolerance = TIGHTEST};
    const Ode ode = {problem_slope, problem_scale, &problem};
    memcpy(problem.z, self->state.values + FIRST_ALGEBRAIC, NZ * sizeof *problem.z);
    if (memory.next > 0 || begin_motion(&ode, self, &memory, self->state.stop_time))
        return memory.next;
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
    Problem problem = {
        .fmu = self,
        .tolerance = fmax(OF_TOLERANCE * state->tolerance, TIGHTEST),
        .trials = MOST_TRIALS,
    };
    const Ode ode = {problem_slope, problem_scale, &problem};
    memcpy(problem.z, state->values + FIRST_ALGEBRAIC, NZ * sizeof *problem.z);
    if (!goes_on && !begin_motion(&ode, self, memory, ahead)) {
        memset(memory, 0, sizeof *memory);
        return false;
    }
    memory->rested = resting;
    memcpy(memory->inputs, u, NU * sizeof *u);
    /* the end of a step that was made in an earlier communication step */
    const bool passes = memory->until > state->values[TIME] && memory->until < end;
    if (passes && self->host.step_finished && !show(&problem, memory, &end)) return false;

    for (;;) {
        double until = ahead;
#if HAS_EVENTS
        end = end_with_event(self, end);
        if (memory->crossing > 0 && memory->since <= end) end = fmax(end, memory->until);
        const int how =
            memory->until <= end ? pass_event(&ode, &problem, memory, end, ahead) : WENT_ON;
        if (how == FAILED) return false;
        if (how == WAITS) return true;
        if (how == HAPPENED) continue;
        until = fmin(fmax(ahead, end), event_before(self, end));
#endif
        if (memory->until >= end) break;
        if (!take_step(&ode, &problem, memory, end, until) ||
            (memory->until < end && !show(&problem, memory, &end))) {
            move_to(&problem, memory, memory->until);
            return false;
        }
    }
    move_to(&problem, memory, end);
    return true;
}
