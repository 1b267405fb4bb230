/* FMI 2.0: the functions of co-simulation. Steps are computed while the importer waits. */
#include "derivatives.h"
#include "events.h"
#include "fmi2.h"
#include "stepping.h"

/* -- inputs and outputs between communication points ------------------------------------------ */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    return ANSWERED(c, IN_SET_INPUT_DERIVATIVES, set_motion(c, vr, nvr, order, value));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    return ANSWERED(c, IN_GET_OUTPUT_DERIVATIVES, get_rates(c, vr, nvr, order, value));
}

/* -- steps ------------------------------------------------------------------------------------ */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint,
                      fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    (void)noSetFMUStatePriorToCurrentPoint;
    return ANSWERED(c, IN_DO_STEP, do_step(c, currentCommunicationPoint, communicationStepSize));
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    return allowed(c, IN_CANCEL_STEP, __func__) ? fmi2OK : fmi2Error;
}

/* -- status of the last step: discard requests without an answer ------------------------------ */

static bool tells(Instance *self, const char *function, bool offered, const void *room,
                  fmi2Status *status) {
    *status = fmi2Error;
    if (!allowed(self, IN_GET_STATUS, function)) return false;
    if (!room)
        refuse(self, ERROR, "there is no room for the value");
    else if (offered)
        *status = fmi2OK;
    else
        *status = fmi2_status(refuse(self, DISCARD, "there is no such status information"));
    return *status == fmi2OK;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value) {
    Instance *self = c;
    fmi2Status status;
    if (tells(self, __func__, s == fmi2DoStepStatus, value, &status))
        *value = fmi2_status(self->state.step_status);
    return status;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    Instance *self = c;
    fmi2Status status;
    if (tells(self, __func__, s == fmi2LastSuccessfulTime, value, &status))
        *value = self->state.values[TIME];
    return status;
}

/* An event may end the simulation. */
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value) {
    Instance *self = c;
    fmi2Status status;
    if (tells(self, __func__, s == fmi2Terminated, value, &status)) *value = run_stopped(self);
    return status;
}

#define NO_STATUS_OF(TYPE)                                                                         \
    fmi2Status fmi2Get##TYPE##Status(fmi2Component c, const fmi2StatusKind s, fmi2##TYPE *value) { \
        fmi2Status status;                                                                         \
        (void)s;                                                                                   \
        tells(c, __func__, false, value, &status);                                                 \
        return status;                                                                             \
    }

NO_STATUS_OF(Integer)
NO_STATUS_OF(String)
