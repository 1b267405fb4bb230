/* FMI 3.0: the functions of co-simulation. */
#include "derivatives.h"
#include "events.h"
#include "fmi3.h"
#include "stepping.h"

/* A step that fails is discarded: the instance is as it was before, and a shorter one may do. It
   returns early where the importer has asked for it in an intermediate update, where an event ends
   the simulation, and at any event that the importer handles in event mode. */
fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    Instance *self = instance;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(self, IN_DO_STEP, __func__)) return fmi3Error;
    if (!eventHandlingNeeded || !terminateSimulation || !earlyReturn || !lastSuccessfulTime)
        return fmi3_status(refuse(self, ERROR, "there is no room for the results"));
    const Status status = do_step(self, currentCommunicationPoint, communicationStepSize);
    const double reached = self->state.values[TIME];
    *eventHandlingNeeded = status == OK && event_waits(self);
    *terminateSimulation = status == OK && run_stopped(self);
    *earlyReturn = status == OK && !*terminateSimulation &&
                   reached < currentCommunicationPoint + communicationStepSize;
    *lastSuccessfulTime = reached;
    return fmi3_status(status);
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance,
                                    const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[],
                                    fmi3Float64 values[], size_t nValues) {
    Instance *self = instance;
    if (!allowed(self, IN_GET_OUTPUT_DERIVATIVES, __func__)) return fmi3Error;
    if (!one_each(self, nValues, nValueReferences)) return fmi3Error;
    return fmi3_status(get_rates(self, valueReferences, nValueReferences, orders, values));
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
    Instance *self = instance;
    if (!allowed(self, IN_ENTER_STEP_MODE, __func__)) return fmi3Error;
    if (self->host.ask_inputs) forget_motion(self);
    leave_instant(self);
    keep_algebraics(self);
    note_inputs(self, false);
    self->state.mode = STEP_MODE;
    return fmi3OK;
}
