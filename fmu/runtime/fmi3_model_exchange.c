/* FMI 3.0: the functions of model exchange. All that happens at an instant does so in
   one update of the discrete states. */
#include "access.h"
#include "evaluation.h"
#include "events.h"
#include "fmi3.h"

/* -- modes ------------------------------------------------------------------------------------ */

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    const Instance *self = instance;
    const bool never = self && self->state.interface == INTERFACE_CS && !self->host.event_mode;
    const unsigned modes = never ? NEVER : IN_ENTER_EVENT_MODE;
    const fmi3Status status = ANSWERED(instance, modes, enter(instance, EVENT_MODE));
    if (status == fmi3OK && self->state.interface == INTERFACE_CS) enter_instant(instance);
    return status;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
    return ANSWERED(instance, IN_ENTER_CONTINUOUS_TIME_MODE, enter_continuous_time(instance));
}

/* Discrete states change in fmi3UpdateDiscreteStates alone. */
fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
    return ANSWERED(instance, IN_DISCRETE_STATES, enter(instance, EVENT_MODE));
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime) {
    Instance *self = instance;
    if (!allowed(self, IN_DISCRETE_STATES, __func__)) return fmi3Error;
    if (!discreteStatesNeedUpdate || !terminateSimulation || !nominalsOfContinuousStatesChanged ||
        !valuesOfContinuousStatesChanged || !nextEventTimeDefined || !nextEventTime)
        return fmi3_status(refuse(self, ERROR, "there is no room for the results"));
    *discreteStatesNeedUpdate = *terminateSimulation = *nextEventTimeDefined = fmi3False;
    *nominalsOfContinuousStatesChanged = *valuesOfContinuousStatesChanged = fmi3False;
    *nextEventTime = 0.0;
    Outcome outcome;
    const Status status = handle_instant(self, take_waiting(self), &outcome);
    *terminateSimulation = outcome.ends;
    *valuesOfContinuousStatesChanged = outcome.states_changed;
#if HAS_EVENTS
    *nextEventTimeDefined = next_event(self) != NEVER_AGAIN;
    if (*nextEventTimeDefined) *nextEventTime = next_event(self);
#endif
    return fmi3_status(status);
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance,
                                       fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode,
                                       fmi3Boolean *terminateSimulation) {
    Instance *self = instance;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(self, IN_COMPLETED_INTEGRATOR_STEP, __func__)) return fmi3Error;
    if (!enterEventMode || !terminateSimulation)
        return fmi3_status(refuse(self, ERROR, "there is no room for the results"));
    *enterEventMode = *terminateSimulation = fmi3False;
    return fmi3_status(complete_integrator_step(self));
}

/* -- time and states -------------------------------------------------------------------------- */

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
    return ANSWERED(instance, IN_SET_TIME, set_time(instance, time));
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates) {
    return ANSWERED(instance, IN_SET_CONTINUOUS_STATES,
                    set_states(instance, continuousStates, nContinuousStates));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[],
                                   size_t nContinuousStates) {
    return ANSWERED(instance, IN_GET_CONTINUOUS,
                    get_block(instance, FIRST_STATE, continuousStates, nContinuousStates));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                             size_t nContinuousStates) {
    return ANSWERED(instance, IN_GET_CONTINUOUS,
                    get_block(instance, FIRST_DERIVATIVE, derivatives, nContinuousStates));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[],
                                             size_t nContinuousStates) {
    return ANSWERED(instance, IN_GET_CONTINUOUS,
                    get_nominals(instance, nominals, nContinuousStates));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[],
                                  size_t nEventIndicators) {
    return ANSWERED(instance, IN_GET_CONTINUOUS,
                    get_indicators(instance, eventIndicators, nEventIndicators));
}

static fmi3Status count(Instance *self, const char *function, size_t number, size_t *result) {
    if (!allowed(self, IN_GET_COUNTS, function)) return fmi3Error;
    if (!result) return fmi3_status(refuse(self, ERROR, "there is no room for the number"));
    *result = number;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators) {
    return count(instance, __func__, N_INDICATORS, nEventIndicators);
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates) {
    return count(instance, __func__, NX, nContinuousStates);
}
