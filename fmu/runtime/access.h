/* Variables by value reference: which may be read, which may be set when and to what. */
#ifndef ACCESS_H
#define ACCESS_H

#include <math.h>
#include <string.h>

#include "constants.h"
#include "evaluation.h"
#include "events.h"
#include "leaps.h"
#include "logging.h"
#if HAS_LOOKS
#include "looks.h"
#endif

/* What must be fresh before a variable of a role is read. */
static const unsigned needed_by[] = {
    [STATE] = START_VALUES,
    [DERIVATIVE] = DERIVATIVES,
    [ALGEBRAIC] = ALGEBRAICS,
    [OUTPUT] = OUTPUTS,
    [TIME] = 0,
    [INPUT] = 0,
    [MODE] = START_VALUES | ALGEBRAICS,
    [PARAMETER] = 0,
};

/* The modes in which a variable may be set (FMI 2.0.4, 3.2.3 and 4.2.4; FMI 3.0.2, 2.3). FMI 2
   leaves inputs out of the first, yet its importers set their start values there. */
static unsigned settable(const Instance *self, const VariableInfo *variable) {
    const unsigned start = INSTANTIATED | INITIALIZATION_MODE;
    switch (variable->role) {
    case INPUT: return start | EVENT_MODE | CONTINUOUS_TIME_MODE | STEP_MODE | INTERMEDIATE_INPUTS;
    case PARAMETER:
        return variable->tunable ? start | EVENT_MODE | CONTINUOUS_TIME_MODE | STEP_MODE : start;
    case ALGEBRAIC: return INSTANTIATED;
    case STATE:
        return (variable->start_kind == CALCULATED ? INSTANTIATED : start) | CONTINUOUS_TIME_MODE |
               (self->host.fmi_version == 3 ? EVENT_MODE : 0);
    default: return 0;
    }
}

/* What is stale once a variable is set: start values may follow from any, up to the end of
   initialization. */
static unsigned dependents(const Instance *self, bool changes) {
    if (self->state.mode & (INSTANTIATED | INITIALIZATION_MODE)) return EVERYTHING;
    const bool steps = self->state.mode == STEP_MODE;
    const bool sides = steps || (self->state.interface == INTERFACE_ME && changes);
    return sides ? AFTER_START | SIDES : AFTER_START;
}

static const char *role_name(Role role) {
    static const char *const names[] = {
        [TIME] = "time",
        [STATE] = "state",
        [DERIVATIVE] = "derivative",
        [ALGEBRAIC] = "algebraic unknown",
        [INPUT] = "input",
        [MODE] = "mode",
        [PARAMETER] = "parameter",
        [OUTPUT] = "output",
    };
    return names[role];
}

/* Check that a list of value references can be read and is of this model. */
static bool all_known(Instance *self, const Reference references[], size_t count) {
    if (count > 0 && !references) {
        refuse(self, ERROR, "%zu value references, but no list", count);
        return false;
    }
    for (size_t i = 0; i < count; i++) {
        if (references[i] < N_VARIABLES) continue;
        refuse(self, ERROR, "value reference %u is unknown; the last one is %d",
               (unsigned)references[i], N_VARIABLES - 1);
        return false;
    }
    return true;
}

static Status refuse_not_finite(Instance *self, size_t reference) {
    const Hint hint = limit_hint(self);
    return refuse(self, DISCARD, "%s is not finite at time %.17g%s%s", variables[reference].name,
                  self->state.values[TIME], hint.joint, hint.limit);
}

/* Values by reference; none is written unless all are defined and finite. */
static Status get_values(Instance *self, const Reference references[], size_t count,
                         double values[]) {
    if (count == 0) return OK;
    if (!all_known(self, references, count)) return ERROR;
    if (!values) return refuse(self, ERROR, "there is no room for the values");

    unsigned needed = 0;
    for (size_t i = 0; i < count; i++) {
        const VariableInfo *variable = &variables[references[i]];
        needed |= needed_by[variable->role];
        if (self->state.mode == INSTANTIATED && variable->start_kind == CALCULATED &&
            variable->role != STATE)
            return refuse(self, DISCARD, "%s has no value before initialization", variable->name);
    }
    if (self->state.mode != INSTANTIATED) { /* there, start values as they stand */
        const Status status = refresh(self, needed);
        if (status != OK) return status;
    }
    for (size_t i = 0; i < count; i++)
        if (!isfinite(self->state.values[references[i]]))
            return refuse_not_finite(self, references[i]);
    for (size_t i = 0; i < count; i++) values[i] = self->state.values[references[i]];
    return OK;
}

static Status check_setting(Instance *self, const VariableInfo *variable, double value) {
    if (!(settable(self, variable) & self->state.mode))
        return refuse(self, ERROR, "%s, a %s%s, cannot be set now", variable->name,
                      variable->start_kind == CALCULATED ? "calculated " : "",
                      role_name(variable->role));
    if (!isfinite(value))
        return refuse(self, DISCARD, "%s = %g is not finite", variable->name, value);
    const bool starting = self->state.mode & (INSTANTIATED | INITIALIZATION_MODE);
    const bool bounded = variable->role == PARAMETER || (starting && variable->role != INPUT);
    if (bounded && !(value >= variable->minimum && value <= variable->maximum))
        return refuse(self, DISCARD, "%s = %g is not within %g ... %g", variable->name, value,
                      variable->minimum, variable->maximum);
    return OK;
}

static bool changes_parameters(const Instance *self, const Reference references[], size_t count,
                               const double values[]) {
    for (size_t i = 0; i < count; i++)
        if (variables[references[i]].role == PARAMETER &&
            memcmp(values + i, self->state.values + references[i], sizeof *values) != 0)
            return true;
    return false;
}

/* Set variables by reference: all of them, or none if one is rejected. */
static Status set_values(Instance *self, const Reference references[], size_t count,
                         const double values[]) {
    if (count == 0) return OK;
    if (!all_known(self, references, count)) return ERROR;
    if (!values) return refuse(self, ERROR, "there are no values");
    for (size_t i = 0; i < count; i++) {
        const Status status = check_setting(self, &variables[references[i]], values[i]);
        if (status != OK) return status;
    }
    const bool runs = !(self->state.mode & (INSTANTIATED | INITIALIZATION_MODE));
    const bool retuned = changes_parameters(self, references, count, values);
    double counts[ROOM(EVENTS)];
    leave_sides(self);
    if (runs && retuned) note_samples(self, counts);
    for (size_t i = 0; i < count; i++) {
        const VariableInfo *variable = &variables[references[i]];
        if (variable->start_kind == CALCULATED && self->state.mode == INSTANTIATED)
            self->state.guesses[references[i] - FIRST_STATE] = values[i];
        const bool changes = self->state.values[references[i]] != values[i];
        self->state.values[references[i]] = values[i];
        self->state.stale |= dependents(self, changes);
        if (variable->role != STATE) continue;
        restart_solver(self);
        keep_instant(self);
    }
    reset_algebraics(self);
    if (!retuned) return OK;
    self->state.retuned = true;
    renew_constants(self);
    if (!runs) return OK;
    rebase_samples(self, counts);
    warn_of_parameters(self);
    return OK;
}

/* All states or all derivatives, in the order of the states. */
static Status get_block(Instance *self, size_t first, double values[], size_t count) {
    if (count != NX) return refuse(self, ERROR, "%zu asked, the model has %d states", count, NX);
    if (count == 0) return OK;
    if (!values) return refuse(self, ERROR, "there is no room for %zu values", count);
    const Status status = refresh(self, needed_by[variables[first].role]);
    if (status != OK) return status;
    for (size_t i = first; i < first + count; i++)
        if (!isfinite(self->state.values[i])) return refuse_not_finite(self, i);
    memcpy(values, self->state.values + first, count * sizeof *values);
    return OK;
}

/* FMI 2 numbers the variables of each type on their own, FMI 3 all of them. */
static uint32_t valid_reference(const Instance *self) {
    return self->host.fmi_version == 2 ? 0 : N_VARIABLES;
}

/* The Boolean variable `valid`, for a list of references to it, whose values have room. */
static Status get_validity(Instance *self, const Reference references[], size_t count,
                           const void *room, bool *valid) {
    if (count == 0) return OK;
    if (!references) return refuse(self, ERROR, "%zu value references, but no list", count);
    for (size_t i = 0; i < count; i++)
        if (!HAS_VALID || references[i] != valid_reference(self))
            return refuse(self, ERROR, "the model has no variable of this type");
    if (self->state.mode == INSTANTIATED)
        return refuse(self, DISCARD, "valid has no value before initialization");
    const Status status = refresh(self, OUTPUTS);
    *valid = self->state.violated == 0;
    if (status == OK && !room) return refuse(self, ERROR, "there is no room for the values");
    return status;
}

/* The margins of the limits, for importers that look for the instants at which they change sign:
   what they try is no crossing yet. */
static Status get_indicators(Instance *self, double values[], size_t count) {
    if (count != N_INDICATORS)
        return refuse(self, ERROR, "%zu asked, the model has %d event indicators", count,
                      N_INDICATORS);
    if (count == 0) return OK;
    if (!values) return refuse(self, ERROR, "there is no room for %zu values", count);
    const Status status = get_margins(self, values);
    if (status != OK) return status;
    for (int i = 0; i < N_LIMITS; i++)
        if (!isfinite(values[i]) || (!HAS_VALID && self->state.outside[i] > 0)) values[i] = -1;
    const Status known = N_WATCHED > 0 ? get_insides(self, values + N_LIMITS) : OK;
#if HAS_LOOKS
    const bool looks = self->state.mode == CONTINUOUS_TIME_MODE && note_look(self);
    if (known == OK && looks) look_between(self, values + N_LIMITS);
#endif
    return known;
}

static Status enter_continuous_time(Instance *self) {
    self->state.mode = CONTINUOUS_TIME_MODE;
#if HAS_LOOKS
    forget_looks(self);
#endif
    note_inputs(self, false);
    begin_watching(self);
#if BOUNDED_LIMITS > 0
    note_look(self);
#endif
    return OK;
}

/* The end of a step of an importer of model exchange. */
static Status complete_integrator_step(Instance *self) {
    const Status status = look_back(self, ERROR);
#if BOUNDED_LIMITS > 0
    if (status == OK && note_look(self)) warn_of_limits(self);
#endif
    return status;
}

static Status get_nominals(Instance *self, double nominals[], size_t count) {
    if (count != NX) return refuse(self, ERROR, "%zu asked, the model has %d states", count, NX);
    if (count > 0 && !nominals)
        return refuse(self, ERROR, "there is no room for %zu values", count);
    for (size_t i = 0; i < count; i++) nominals[i] = variables[FIRST_STATE + i].nominal;
    return OK;
}

/* Set all states at once; discard, with the states as they were, where one is not finite. */
static Status set_states(Instance *self, const double x[], size_t count) {
    if (count != NX) return refuse(self, ERROR, "%zu given, the model has %d states", count, NX);
    if (count == 0) return OK;
    if (!x) return refuse(self, ERROR, "there are no values");
    if (memcmp(self->state.values + FIRST_STATE, x, count * sizeof *x) == 0) return OK;
    for (size_t i = 0; i < count; i++)
        if (!isfinite(x[i]))
            return refuse(self, DISCARD, "%s = %g is not finite", variables[FIRST_STATE + i].name,
                          x[i]);
    memcpy(self->state.values + FIRST_STATE, x, count * sizeof *x);
    self->state.stale |= AFTER_START;
    return OK;
}

static Status set_time(Instance *self, double time) {
    if (!isfinite(time)) return refuse(self, ERROR, "time %g is not finite", time);
    if (time == self->state.values[TIME]) return OK;
    self->state.values[TIME] = time;
    self->state.stale |= AFTER_START;
    return OK;
}

#endif
