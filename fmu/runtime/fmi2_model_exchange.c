/* FMI 2.0: the functions of model exchange. All that happens at an instant does so in
   one update of the discrete states. */
#include "access.h"
#include "evaluation.h"
#include "events.h"
#include "fmi2.h"

/* -- modes ------------------------------------------------------------------------------------ */

static fmi2Status enter(Instance *self, unsigned modes, const char *function, uint32_t mode) {
    if (!allowed(self, modes, function)) return fmi2Error;
    self->state.mode = mode;
    return fmi2OK;
}

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    return enter(c, IN_ENTER_EVENT_MODE, __func__, EVENT_MODE);
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    const fmi2Status status =
        enter(c, IN_ENTER_CONTINUOUS_TIME_MODE, __func__, CONTINUOUS_TIME_MODE);
    if (status == fmi2OK) begin_piece(c);
    return status;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *fmi2eventInfo) {
    Instance *self = c;
    if (!allowed(self, IN_NEW_DISCRETE_STATES, __func__)) return fmi2Error;
    if (!fmi2eventInfo) return fmi2_status(refuse(self, ERROR, "there is no room for the results"));
    *fmi2eventInfo = (fmi2EventInfo){0}; /* nothing to update, nothing changed, no event to come */
    Outcome outcome;
    const Status status = handle_instant(self, -1, &outcome);
    fmi2eventInfo->terminateSimulation = outcome.ends;
    fmi2eventInfo->valuesOfContinuousStatesChanged = outcome.states_changed;
#if HAS_EVENTS
    fmi2eventInfo->nextEventTimeDefined = next_event(self) != NEVER_AGAIN;
    fmi2eventInfo->nextEventTime = fmi2eventInfo->nextEventTimeDefined ? next_event(self) : 0.0;
#endif
    return fmi2_status(status);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c,
                                       fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode,
                                       fmi2Boolean *terminateSimulation) {
    Instance *self = c;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(self, IN_COMPLETED_INTEGRATOR_STEP, __func__)) return fmi2Error;
    if (!enterEventMode || !terminateSimulation)
        return fmi2_status(refuse(self, ERROR, "there is no room for the results"));
    *enterEventMode = *terminateSimulation = fmi2False;
    return fmi2_status(look_back(self, ERROR));
}

/* -- time and states -------------------------------------------------------------------------- */

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Instance *self = c;
    if (!allowed(self, IN_SET_TIME, __func__)) return fmi2Error;
    return fmi2_status(set_time(self, time));
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    Instance *self = c;
    if (!allowed(self, IN_SET_CONTINUOUS_STATES, __func__)) return fmi2Error;
    return fmi2_status(set_states(self, x, nx));
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
    Instance *self = c;
    if (!allowed(self, IN_GET_CONTINUOUS_STATES, __func__)) return fmi2Error;
    return fmi2_status(get_block(self, FIRST_STATE, x, nx));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
    Instance *self = c;
    if (!allowed(self, IN_GET_DERIVATIVES, __func__)) return fmi2Error;
    return fmi2_status(get_block(self, FIRST_DERIVATIVE, derivatives, nx));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
    Instance *self = c;
    if (!allowed(self, IN_GET_NOMINALS, __func__)) return fmi2Error;
    return fmi2_status(get_nominals(self, x_nominal, nx));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
    Instance *self = c;
    if (!allowed(self, IN_GET_EVENT_INDICATORS, __func__)) return fmi2Error;
    return fmi2_status(get_indicators(self, eventIndicators, ni));
}
