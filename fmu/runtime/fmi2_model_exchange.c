/* FMI 2.0: the functions of model exchange. All that happens at an instant does so in
   one update of the discrete states. */
#include "access.h"
#include "evaluation.h"
#include "events.h"
#include "fmi2.h"

/* -- modes ------------------------------------------------------------------------------------ */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    return ANSWERED(c, IN_ENTER_EVENT_MODE, enter(c, EVENT_MODE));
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    return ANSWERED(c, IN_ENTER_CONTINUOUS_TIME_MODE, enter_continuous_time(c));
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
    return fmi2_status(complete_integrator_step(self));
}

/* -- time and states -------------------------------------------------------------------------- */

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    return ANSWERED(c, IN_SET_TIME, set_time(c, time));
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    return ANSWERED(c, IN_SET_CONTINUOUS_STATES, set_states(c, x, nx));
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
    return ANSWERED(c, IN_GET_CONTINUOUS_STATES, get_block(c, FIRST_STATE, x, nx));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
    return ANSWERED(c, IN_GET_DERIVATIVES, get_block(c, FIRST_DERIVATIVE, derivatives, nx));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
    return ANSWERED(c, IN_GET_NOMINALS, get_nominals(c, x_nominal, nx));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
    return ANSWERED(c, IN_GET_EVENT_INDICATORS, get_indicators(c, eventIndicators, ni));
}
