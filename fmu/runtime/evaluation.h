/* Results on demand: each group of equations runs once after a setter made it stale. */
#ifndef EVALUATION_H
#define EVALUATION_H

#include <math.h>
#include <string.h>

#include "constants.h"
#include "equations.h"
#include "integration.h"
#include "logging.h"
#include "modes.h"
#include "rank.h"
#include "validity.h"

#if HAS_RANK
static const double LOW_RANK = 0.1; /* of the constraints, 1 at best: a likely cause of a failure */
#endif
static const double LARGEST_DEFECT = 1e-9; /* scaled residual of a calculated start value */

/* Warn of changes of the equations that parameters have moved, or made short. */
static void warn_of_parameters(Instance *self) {
#if N_WARNINGS > 0
    double values[N_WARNINGS];
    self->arg[0] = self->constants;
    self->res[0] = values;
    if (model_warnings(self->arg, self->res, self->iw, self->w, 0)) return;
    for (int i = 0; i < N_WARNINGS; i++)
        if (values[i] <= 0)
            log_text(self, WARNING,
                     "%s, which a solver may step over; export the model with the new value",
                     warnings[i]);
#else
    (void)self;
#endif
}

static bool all_finite(const double values[], int count) {
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i])) return false;
    return true;
}

/* Names of the states with calculated start values, as far as they fit. */
static void name_calculated(char text[], size_t size) {
    size_t used = 0;
    text[0] = '\0';
    for (int i = FIRST_STATE; i < FIRST_DERIVATIVE; i++) {
        if (variables[i].start_kind != CALCULATED) continue;
        const char *parts[] = {used ? ", " : "", variables[i].name};
        const size_t lengths[] = {strlen(parts[0]), strlen(parts[1])};
        if (used + lengths[0] + lengths[1] >= size) return;
        for (int k = 0; k < 2; used += lengths[k++]) memcpy(text + used, parts[k], lengths[k]);
        text[used] = '\0';
    }
}

/* Start values: the exact ones stay, the calculated ones follow from them, time, inputs and
   parameters. */
static Status settle_start(Instance *self) {
    double *values = self->state.values;
    double guess[ROOM(NX)], x[ROOM(NX)] = {0}, defect = 0;
    for (int i = 0; i < NX; i++) {
        const VariableInfo *state = &variables[FIRST_STATE + i];
        guess[i] =
            state->start_kind == CALCULATED ? self->state.guesses[i] : values[FIRST_STATE + i];
    }
    self->arg[0] = values + TIME;
    self->arg[1] = guess;
    self->arg[2] = values + FIRST_INPUT;
    self->arg[3] = self->constants;
    self->res[0] = x;
    self->res[1] = &defect;
    const int failed = model_start(self->arg, self->res, self->iw, self->w, 0);
    if (failed || !all_finite(x, NX) || !(defect <= LARGEST_DEFECT)) {
        char names[300];
        name_calculated(names, sizeof names);
        return refuse(self, DISCARD, "the start values of %s cannot be calculated (defect %.3g)",
                      names, defect);
    }
    memcpy(values + FIRST_STATE, x, NX * sizeof(double));
    return start_modes(self);
}

/* Pass a point whose algebraic unknowns are solved for from their guess; false without a solution.
 */
static bool solve_point(Instance *self, const double *t, const double x[], double z[],
                        const double u[]) {
    double solved[ROOM(NZ)] = {0};
    pass_point(self, t, x, z, u);
    if (NZ == 0) return true;
    self->res[0] = solved;
    if (model_algebraic(self->arg, self->res, self->iw, self->w, 0) || !all_finite(solved, NZ))
        return false;
    memcpy(z, solved, NZ * sizeof *z);
    return true;
}

/* The margins alone, noted nowhere, where the arguments of the equations are passed; 0 is success.
 */
static int compute_margins(Instance *self, double margins[]) {
    self->res[0] = NULL;
    self->res[1] = margins;
    return model_outputs(self->arg, self->res, self->iw, self->w, 0);
}

/* The margins of the limits at a time of a motion; false where they have no value. */
static bool margins_on(Instance *self, const Motion *motion, double t, double margins[]) {
    double x[ROOM(NX)] = {0}, z[ROOM(NZ)] = {0}, u[ROOM(NU)] = {0};
    motion->at(motion->solver, t, x, z, u);
#if HAS_EVENTS
    if (!follow_at(self, &(Point){t, x, z, u})) return false;
#endif
    return solve_point(self, &t, x, z, u) && !compute_margins(self, margins);
}

/* What to add to a message of failure at the present values. */
static Hint limit_hint(Instance *self) {
#if HAS_RANK
    pass_values(self);
    if (rank_at(self, NULL) < LOW_RANK)
        return (Hint){"; nearby, ", "the constraints lose rank, where branches of motion meet"};
#endif
    double margins[ROOM(N_LIMITS)] = {0};
    for (int i = 0; i < N_LIMITS; i++) margins[i] = NAN;
    pass_values(self);
    if (N_LIMITS > 0) compute_margins(self, margins);
    return nearest_limit(self, margins);
}

/* Between communication steps, solutions begin at the end of the last step, whatever has been read
   since: reading results changes none that follow. */
static void keep_algebraics(Instance *self) {
    memcpy(self->state.reached, self->state.values + FIRST_ALGEBRAIC, NZ * sizeof(double));
}

static void reset_algebraics(Instance *self) {
    if (self->state.mode == STEP_MODE && self->state.stale & ALGEBRAICS)
        memcpy(self->state.values + FIRST_ALGEBRAIC, self->state.reached, NZ * sizeof(double));
}

/* Algebraic unknowns; the last solution is the guess, and stays where there is no new one. */
static Status solve_algebraics(Instance *self) {
    const Status status = follow_present(self);
    if (status != OK) return status;
    if (NZ == 0) return OK;
    double z[ROOM(NZ)] = {0};
    pass_values(self);
    self->res[0] = z;
    const int failed = model_algebraic(self->arg, self->res, self->iw, self->w, 0);
    if (failed || !all_finite(z, NZ)) {
        const Hint hint = limit_hint(self);
        return refuse(self, DISCARD, "the algebraic equations have no solution at time %.17g%s%s",
                      self->state.values[TIME], hint.joint, hint.limit);
    }
    memcpy(self->state.values + FIRST_ALGEBRAIC, z, NZ * sizeof(double));
    return OK;
}

static Status compute(Instance *self, Equation *equation, double *results, const char *what) {
    pass_values(self);
    self->res[0] = results;
    if (!equation(self->arg, self->res, self->iw, self->w, 0)) return OK;
    const Hint hint = limit_hint(self);
    return refuse(self, DISCARD, "the %s cannot be computed at time %.17g%s%s", what,
                  self->state.values[TIME], hint.joint, hint.limit);
}

/* Outputs, and with them what the model says of its own validity. */
static Status compute_outputs(Instance *self) {
    double margins[ROOM(N_LIMITS)] = {0};
    self->res[1] = margins;
    const Status status =
        compute(self, model_outputs, self->state.values + FIRST_OUTPUT, "outputs");
    if (status != OK) return status;
    /* inputs that are read between steps need not be those of a motion */
    const bool beside = self->state.mode == STEP_MODE && self->state.steps > 0 && !self->stepping;
    if (!beside) note_margins(self, margins);
    if (N_WATCHED == 0) return OK;
    return get_insides(self, self->state.values + FIRST_OUTPUT + NY - N_WATCHED);
}

static Status compute_derivatives(Instance *self) {
    const Status status =
        compute(self, model_ode, self->state.values + FIRST_DERIVATIVE, "derivatives");
    if (status == OK) note_rank(self);
    return status;
}

static Status renew(Instance *self, unsigned result) {
    switch (result) {
    case START_VALUES: return settle_start(self);
    case ALGEBRAICS: return solve_algebraics(self);
    case DERIVATIVES: return compute_derivatives(self);
    case OUTPUTS: return compute_outputs(self);
    default:
#if NO_DERIVATIVES
        return OK;
#else
        self->res[1] = self->jacobian + NX * (NX + NU);
        return compute(self, model_jacobian, self->jacobian, "Jacobian");
#endif
    }
}

/* Renew what is stale among `results` and among what they follow from. On failure, discard:
   nothing is lost, and the importer may shorten its step. */
static Status refresh(Instance *self, unsigned results) {
    if (results) take_sides(self);
    if (results & AFTER_START) results |= START_VALUES;
    if (results & (DERIVATIVES | OUTPUTS | JACOBIAN)) results |= ALGEBRAICS;
    for (unsigned result = START_VALUES; result <= JACOBIAN; result <<= 1) {
        if (!(results & self->state.stale & result)) continue;
        const Status status = renew(self, result);
        if (status != OK) return status;
        self->state.stale &= ~result;
    }
    return OK;
}

/* Whether all derivatives have a value. What is kept of a point goes into the FMU state. */
static bool has_derivatives(Instance *self) {
    return refresh(self, DERIVATIVES) == OK &&
           all_finite(self->state.values + FIRST_DERIVATIVE, NX);
}

/* Check the validity conditions even if no output is read. */
static void note_limits(Instance *self) {
    if (N_LIMITS > 0) refresh(self, OUTPUTS);
}

/* Check the validity conditions, which an importer may have located, and start to detect singular
   configurations, in models with a detector. */
static void begin_watching(Instance *self) {
    note_limits(self);
    if (HAS_RANK && has_derivatives(self)) begin_watch(self);
}

/* Return `status` if the model has passed a singular configuration since the last check, or if
   what slides is moved by an importer that does not tell how; discard where that is unknown. */
static Status look_back(Instance *self, Status status) {
    const bool exchange = self->state.interface == INTERFACE_ME;
    const Status completed = exchange ? complete_step(self, status) : OK;
    if (completed != OK) return completed;
    return HAS_RANK && has_derivatives(self) ? watch_rank(self, status) : OK;
}

/* The margins of the limits at the present values, which need not be those of a solution. */
static Status get_margins(Instance *self, double margins[]) {
    const Status status = refresh(self, ALGEBRAICS);
    pass_values(self);
    if (status != OK || !compute_margins(self, margins)) return status;
    return refuse(self, DISCARD, "the margins of the limits cannot be computed at time %.17g",
                  self->state.values[TIME]);
}

#endif
