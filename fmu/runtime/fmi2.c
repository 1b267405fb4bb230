/* FMI 2.0: the functions common to model exchange and co-simulation. */
#include "fmi2.h"
#include "access.h"
#include "initialization.h"
#include "sensitivity.h"
#include "snapshot.h"

/* -- information, creation, logging ----------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) {
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void) {
    return fmi2Version;
}

static void log_fmi2(const Instance *self, Status status, const char *category, const char *text) {
    const fmi2CallbackLogger logger = (fmi2CallbackLogger)self->host.logger;
    logger(self->host.environment, self->name, fmi2_status(status), category, text);
}

/* The resource location is not needed and not read; nothing is ever visible. Memory is the
   library's own (canNotUseMemoryManagementFunctions): importers' functions differ in what they
   zero and align. */
fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean loggingOn) {
    (void)fmuResourceLocation;
    (void)visible;
    if (!functions) return NULL;
    const Host host = {
        .fmi_version = 2,
        .log = log_fmi2,
        .logger = (void (*)(void))functions->logger,
        .environment = functions->componentEnvironment,
    };
    const unsigned interface = fmuType == fmi2ModelExchange  ? INTERFACE_ME
                               : fmuType == fmi2CoSimulation ? INTERFACE_CS
                                                             : 0;
    return create(&host, __func__, instanceName, fmuGUID, interface, loggingOn);
}

void fmi2FreeInstance(fmi2Component c) {
    destroy(c);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[]) {
    Instance *self = c;
    if (!allowed(self, IN_SET_DEBUG_LOGGING, __func__)) return fmi2Error;
    return fmi2_status(choose_categories(self, loggingOn, nCategories, categories));
}

/* -- initialization, termination, reset ------------------------------------------------------- */

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    Instance *self = c;
    if (!allowed(self, IN_SETUP_EXPERIMENT, __func__)) return fmi2Error;
    return fmi2_status(set_up(self, toleranceDefined ? &tolerance : NULL, startTime,
                              stopTimeDefined ? &stopTime : NULL));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *self = c;
    if (!allowed(self, IN_ENTER_INITIALIZATION_MODE, __func__)) return fmi2Error;
    if (!self->state.experiment_set)
        return fmi2_status(refuse(self, ERROR, "call fmi2SetupExperiment first"));
    self->state.mode = INITIALIZATION_MODE;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Instance *self = c;
    if (!allowed(self, IN_EXIT_INITIALIZATION_MODE, __func__)) return fmi2Error;
    return fmi2_status(finish_initialization(self));
}

fmi2Status fmi2Terminate(fmi2Component c) {
    Instance *self = c;
    if (!allowed(self, IN_TERMINATE, __func__)) return fmi2Error;
    self->state.mode = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    Instance *self = c;
    if (!allowed(self, IN_RESET, __func__)) return fmi2Error;
    reset(self);
    return fmi2OK;
}

/* -- variables: all are Real, but for `valid`
 * ------------------------------------------------------------------ */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       fmi2Real value[]) {
    Instance *self = c;
    if (!allowed(self, IN_GET_VALUES, __func__)) return fmi2Error;
    return fmi2_status(get_values(self, vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       const fmi2Real value[]) {
    Instance *self = c;
    if (!allowed(self, IN_SET_REAL, __func__)) return fmi2Error;
    return fmi2_status(set_values(self, vr, nvr, value));
}

static fmi2Status no_variables(Instance *self, unsigned modes, const char *function, size_t nvr) {
    if (!allowed(self, modes, function)) return fmi2Error;
    if (nvr == 0) return fmi2OK;
    return fmi2_status(refuse(self, ERROR, "the model has no variable of this type"));
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Integer value[]) {
    (void)vr, (void)value;
    return no_variables(c, IN_GET_VALUES, __func__, nvr);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Boolean value[]) {
    Instance *self = c;
    if (!allowed(self, IN_GET_VALUES, __func__)) return fmi2Error;
    bool valid = false;
    const Status status = get_validity(self, vr, nvr, &valid);
    if (status == OK && nvr > 0 && !value)
        return fmi2_status(refuse(self, ERROR, "there is no room for the values"));
    for (size_t i = 0; status == OK && i < nvr; i++) value[i] = valid;
    return fmi2_status(status);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         fmi2String value[]) {
    (void)vr, (void)value;
    return no_variables(c, IN_GET_VALUES, __func__, nvr);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Integer value[]) {
    (void)vr, (void)value;
    return no_variables(c, IN_SET_DISCRETE, __func__, nvr);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Boolean value[]) {
    (void)vr, (void)value;
    return no_variables(c, IN_SET_DISCRETE, __func__, nvr);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         const fmi2String value[]) {
    (void)vr, (void)value;
    return no_variables(c, IN_SET_DISCRETE, __func__, nvr);
}

/* -- derivatives with respect to variables ---------------------------------------------------- */

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[],
                                        size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    Instance *self = c;
    if (!allowed(self, IN_GET_DIRECTIONAL_DERIVATIVE, __func__)) return fmi2Error;
    return fmi2_status(
        directional(self, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown));
}

/* -- the FMU state ---------------------------------------------------------------------------- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *self = c;
    if (!allowed(self, IN_FMU_STATE, __func__)) return fmi2Error;
    return fmi2_status(take_snapshot(self, FMUstate));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    Instance *self = c;
    if (!allowed(self, IN_FMU_STATE, __func__)) return fmi2Error;
    return fmi2_status(restore_snapshot(self, FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *self = c;
    if (!allowed(self, IN_FMU_STATE, __func__)) return fmi2Error;
    return fmi2_status(release_snapshot(self, FMUstate));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    Instance *self = c;
    if (!allowed(self, IN_FMU_STATE, __func__)) return fmi2Error;
    return fmi2_status(snapshot_size(self, FMUstate, size));
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                 size_t size) {
    Instance *self = c;
    if (!allowed(self, IN_FMU_STATE, __func__)) return fmi2Error;
    return fmi2_status(serialize(self, FMUstate, serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    Instance *self = c;
    if (!allowed(self, IN_FMU_STATE, __func__)) return fmi2Error;
    return fmi2_status(deserialize(self, serializedState, size, FMUstate));
}
