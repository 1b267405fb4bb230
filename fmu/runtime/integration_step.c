/* Co-simulation by a generated solver, which starts anew in every communication step.

   With FIXED_STEPS, which tells how many stages they have, a communication step has equal steps, no
   longer than LARGEST_STEP, and the work is the same in each of them; only an event divides one. */
#include "integration.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "bounds.h"
#include "equations.h"
#include "evaluation.h"
#include "events.h"
#include "input_motion.h"
#include "logging.h"
#include "midway.h"
#include "quintic.h"

/* Attempts in one communication step without events. A failed one is repeated at a quarter of its
   length, so that the step ends within about 4^-5 of its length before what stops it. Failed
   attempts times the integrator's own limit of steps bound the work of a call. */
enum { MOST_PARTS = 50, MOST_ATTEMPTS = 12, MOST_FAILED = 6 };

/* Integrate up to a time; on failure nothing has changed. `stages`: takes the slopes of the stages
   of a step of fixed size, or NULL. */
static bool advance(Instance *self, double end, double *stages) {
    double *values = self->state.values;
    const double length = end - values[TIME];
    double q[3 + (1 + MOST_INPUT_ORDER) * NU + NC], x[ROOM(NX)] = {0}, z[ROOM(NZ)] = {0};
    double *next = q + 3, factor = 1;
    q[0] = values[TIME];
    q[1] = length;
    q[2] = self->state.tolerance;
    for (int i = 0; i < NU; i++) *next++ = values[FIRST_INPUT + i];
    for (int order = 1; order <= MOST_INPUT_ORDER; order++) {
        factor *= length / order;
        for (int i = 0; i < NU; i++) *next++ = self->state.motion[order - 1][i] * factor;
    }
    memcpy(next, self->constants, NC * sizeof *self->constants);
    self->arg[0] = values + FIRST_STATE;
    self->arg[1] = values + FIRST_ALGEBRAIC;
    self->arg[2] = q;
    self->res[0] = x;
    self->res[1] = z;
    self->res[2] = stages;
    if (model_step(self->arg, self->res, self->iw, self->w, 0)) return false;
    if (!all_finite(x, NX) || !all_finite(z, NZ)) return false;

    memcpy(values + FIRST_STATE, x, NX * sizeof *x);
    memcpy(values + FIRST_ALGEBRAIC, z, NZ * sizeof *z);
    move_inputs(self, end);
    self->state.stale |= AFTER_START;
    return true;
}

void restart_solver(Instance *self) {
    (void)self; /* it does so in every communication step */
}

/* A tenth of the time in which the states change by their sizes. */
double typical_step(Instance *self) {
    const double *values = self->state.values;
    double size = 0, rate = 0;
    if (refresh(self, DERIVATIVES) != OK) return LARGEST_STEP;
    for (int i = 0; i < NX; i++) {
        const double nominal = variables[FIRST_STATE + i].nominal;
        size = fmax(size, fabs(values[FIRST_STATE + i]) / nominal);
        rate = fmax(rate, fabs(values[FIRST_DERIVATIVE + i]) / nominal);
    }
    return fmin(LARGEST_STEP, 0.1 * fmax(size, 0.01) / fmax(rate, DBL_MIN));
}

/* A step that has been made, and the motion within it. */
typedef struct {
    Instance *fmu;
    const State *from, *to;
    const double *stages; /* of a step of fixed size */
    double slopes[2][ROOM(NX)];
    Quintic quintic;
} Made;

static void within_step(void *made, double t, double x[], double z[], double u[]) {
    const Made *self = made;
    double rates[ROOM(NX)];
    on_quintic(&self->quintic, t, x, rates);
    memcpy(z, self->from->values + FIRST_ALGEBRAIC, NZ * sizeof *z);
    inputs_at(self->fmu, t, u);
}

static void box_of_step(void *made, double low[], double high[]) {
    const Made *self = made;
    const double *a = self->from->values, *b = self->to->values, h = b[TIME] - a[TIME];
    for (int i = 0; i < NX; i++) {
#if FIXED_STEPS > 0
        const Span span = span_of_stages(self->stages + i, FIXED_STEPS, NX, a[FIRST_STATE + i], h);
        low[i] = span.low;
        high[i] = span.high;
#else
        box_of_cubic(a[FIRST_STATE + i], b[FIRST_STATE + i], self->slopes[0][i], self->slopes[1][i],
                     h, &low[i], &high[i]);
#endif
    }
}

/* dx/dt within the step. */
static int slope_within(void *made, double t, const double *x, double *dx) {
    const Made *self = made;
    Instance *fmu = self->fmu;
    double *values = fmu->state.values;
    memcpy(values + FIRST_STATE, x, NX * sizeof *x);
    move_inputs(fmu, t);
    fmu->state.stale |= AFTER_START;
    const bool known = refresh(fmu, DERIVATIVES) == OK;
    memcpy(dx, values + FIRST_DERIVATIVE, NX * sizeof *dx);
    fmu->state = *self->to;
    return !known;
}

/* A step from a state, whose derivatives must be fresh, to the present one, which `to` takes. */
static bool through_ends(Instance *self, const State *from, const double *stages, State *to,
                         Made *made, Motion *motion) {
    if (refresh(self, DERIVATIVES) != OK) return false;
    *to = self->state;
    const double *a = from->values, *b = to->values;
    made->fmu = self;
    made->from = from;
    made->to = to;
    made->stages = stages;
    memcpy(made->slopes[0], a + FIRST_DERIVATIVE, NX * sizeof *a);
    memcpy(made->slopes[1], b + FIRST_DERIVATIVE, NX * sizeof *b);
    made->quintic = (Quintic){.t = a[TIME],
                              .h = b[TIME] - a[TIME],
                              .ends = {a + FIRST_STATE, b + FIRST_STATE},
                              .slopes = {made->slopes[0], made->slopes[1]},
                              .slope = slope_within,
                              .owner = made,
                              .looks = FIXED_STEPS > 0 ? looks_for(ORDER_OF_STEPS) : 0};
    *motion = (Motion){.solver = made, .at = within_step, .quintic = &made->quintic};
    return true;
}

/* When a step that ends here leaves each limit first, up to a time. */
static bool leaving_in_step(Instance *self, const State *from, const double *stages, double end,
                            double leaving[]) {
    Made made;
    State to;
    Motion motion;
    if (!through_ends(self, from, stages, &to, &made, &motion)) return false;
    if (!(end > to.values[TIME])) motion.box = box_of_step;
    find_leaving(self, &motion, from->values[TIME], end, leaving);
    return true;
}

static const double NEAR = 8; /* share of a step beyond its end where its cubic still holds */

/* Warn of limits that a step leaves, which has been made and begins with fresh derivatives. A step
   that ends where its motion leaves a limit is exact there. */
static void look_at_limits(Instance *self, const State *from, const double *stages) {
    const double begin = from->values[TIME], end = self->state.values[TIME];
    double leaving[ROOM(N_LIMITS)], better[ROOM(N_LIMITS)];
    if (N_LIMITS == 0 || !leaving_in_step(self, from, stages, end, leaving)) return;
    const State to = self->state;
    for (int i = 0; i < N_LIMITS; i++) {
        if (!(leaving[i] > begin && leaving[i] < end)) continue;
        const double beyond = fmin(leaving[i] + (end - begin) / NEAR, end);
        self->state = *from;
        if (advance(self, leaving[i], NULL) && leaving_in_step(self, from, NULL, beyond, better))
            leaving[i] = better[i];
        self->state = to;
    }
    note_leaving(self, end, leaving);
}

#if HAS_EVENTS || !FIXED_STEPS
/* Factors of the length between two looks: where the solver fails, as it does after a limited
   number of steps, and where it succeeds. */
static const double SHORTER = 0.25, LONGER = 1.2;
#endif

#if HAS_EVENTS
/* Repeat the step so that it ends at a time; the instance is there then. */
static bool step_again(void *made, double t, double x[], double z[], double u[]) {
    const Made *self = made;
    const double *values = self->fmu->state.values;
    self->fmu->state = *self->from;
    if (t > self->from->values[TIME] && !advance(self->fmu, t, NULL)) return false;
    if (refresh(self->fmu, ALGEBRAICS) != OK) return false;
    memcpy(x, values + FIRST_STATE, NX * sizeof *x);
    memcpy(z, values + FIRST_ALGEBRAIC, NZ * sizeof *z);
    memcpy(u, values + FIRST_INPUT, NU * sizeof *u);
    return true;
}

/* End a step that has been made where a relation first leaves its mode, if one does. */
static bool end_at_crossing(Instance *self, const State *from, const double *stages,
                            int *relation) {
    Made made;
    State to;
    Motion motion;
    if (!through_ends(self, from, stages, &to, &made, &motion)) return false;
    motion.step_to = step_again;
    motion.stages = stages;
    Crossing crossing;
    const double begin = from->values[TIME], end = to.values[TIME];
    if (!find_event(self, &motion, begin, end, &crossing)) return false;
    *relation = crossing.relation;
    if (crossing.relation >= 0) return true;
    const Switching noted = self->state.switching;
    self->state = to;
    self->state.switching = noted;
    return true;
}

static bool cannot_slide(Instance *self) {
    if (!is_sliding_now(self)) return false;
    refuse(self, ERROR,
           "an expression slides along 0 at %.12g s, which the solver of this FMU cannot follow; "
           "export it with solver dop853",
           self->state.values[TIME]);
    return true;
}

bool integrate_to(Instance *self, double end) {
    const double *time = &self->state.values[TIME];
    double length = fmin(end - *time, LARGEST_STEP);
    double stages[ROOM(FIXED_STEPS * NX)];
    int relation = -1;
    if (!start_over(self) || refresh(self, ALGEBRAICS) != OK) return false;
    if (event_waits(self)) return true;
    for (int n = 0; n < MOST_TRIALS && (*time >= end || *time + length > *time); n++) {
        if (relation >= 0 || next_event(self) <= *time) {
            Outcome outcome;
            if (leave_to_importer(self, relation)) return true;
            if (*time >= end) remember_instant(self);
            if (handle_instant(self, relation, &outcome) != OK || outcome.ends) return false;
            relation = -1;
            continue;
        }
        end = end_with_event(self, end);
        if (*time >= end) return true;
        if (cannot_slide(self) || refresh(self, DERIVATIVES) != OK) return false;
        const double goal = fmin(end, event_before(self, end)), rest = goal - *time;
        const State before = self->state;
        const bool last = length >= rest || goal - (*time + length) <= 8 * ulp(goal);
        if (advance(self, last ? goal : *time + length, FIXED_STEPS > 0 ? stages : NULL)) {
            if (!end_at_crossing(self, &before, stages, &relation)) {
                self->state = before;
                return false;
            }
            if (relation >= 0) move_inputs(self, end_if_only_rounding(self, *time, end));
            look_at_limits(self, &before, stages);
            length = fmin(length * LONGER, LARGEST_STEP);
            if (*time < end && !pass_midway(self, &end)) return false;
        } else {
            length = SHORTER * (last ? rest : length);
        }
    }
    return false;
}
#else
enum { FAILED, LOST, DONE };

/* A step up to a time; LOST: the constraints lose rank in it. Only a step that is DONE changes
   anything. */
static int watched_step(Instance *self, double end) {
    if (refresh(self, ALGEBRAICS) != OK) return LOST; /* the guess must be a solution */
    if (N_LIMITS > 0 && refresh(self, DERIVATIVES) != OK) return FAILED;
#if HAS_RANK
    if (self->state.watch.looks == 0) begin_watching(self);
#endif
    const State before = self->state;
    double stages[ROOM(FIXED_STEPS * NX)];
    if (!advance(self, end, FIXED_STEPS * N_LIMITS > 0 ? stages : NULL)) return FAILED;
    look_at_limits(self, &before, stages);
#if HAS_RANK
    if (look_back(self, DISCARD) != OK) {
        self->state = before;
        return LOST;
    }
#endif
    return DONE;
}

#if FIXED_STEPS
bool integrate_to(Instance *self, double end) {
    const double *time = &self->state.values[TIME], begin = *time, span = end - begin;
    const double count = fmax(1, ceil(span / LARGEST_STEP * (1 - 1e-12)));
    for (double k = 1; *time < end && k <= MOST_TRIALS; k++) {
        const double next = k < count ? begin + span * k / count : end;
        if (watched_step(self, fmin(next, end)) != DONE) return false;
        if (*time < end && !pass_midway(self, &end)) return false;
    }
    return *time >= end;
}
#else
bool integrate_to(Instance *self, double end) {
    const double *time = &self->state.values[TIME];
    const double span = end - *time; /* in parts between two looks at limits */
    const double longest = N_LIMITS > 0 ? fmax(LARGEST_STEP, span / MOST_PARTS) : span;
    const int most = MOST_ATTEMPTS + (N_LIMITS > 0 ? MOST_PARTS : 0);
    double length = longest;
    int failed = 0;
    for (int attempt = 0; attempt < most && *time < end && failed < MOST_FAILED; attempt++) {
        const double rest = end - *time;
        const bool last = length >= rest;
        const int how = watched_step(self, last ? end : *time + length);
        if (how == LOST) return false;
        if (how == FAILED) {
            failed++;
            length = SHORTER * (last ? rest : length);
        } else {
            length = fmin(length * LONGER, longest);
            if (*time < end && !pass_midway(self, &end)) return false;
        }
    }
    return *time >= end;
}
#endif
#endif
