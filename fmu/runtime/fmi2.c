/* FMI 2.0: the functions common to model exchange and co-simulation. */
#include "fmi2.h"
#include "access.h"
#include "derivatives.h"
#include "initialization.h"
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
    return ANSWERED(c, IN_SET_DEBUG_LOGGING,
                    choose_categories(c, loggingOn, nCategories, categories));
}

/* -- initialization, termination, reset ------------------------------------------------------- */

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    return ANSWERED(c, IN_SETUP_EXPERIMENT,
                    set_up(c, toleranceDefined ? &tolerance : NULL, startTime,
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
    return ANSWERED(c, IN_EXIT_INITIALIZATION_MODE, finish_initialization(c));
}

fmi2Status fmi2Terminate(fmi2Component c) {
    return ANSWERED(c, IN_TERMINATE, enter(c, TERMINATED));
}

fmi2Status fmi2Reset(fmi2Component c) {
    if (!allowed(c, IN_RESET, __func__)) return fmi2Error;
    reset(c);
    return fmi2OK;
}

/* -- variables: all are Real, but for `valid` -------------------------------------------------- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       fmi2Real value[]) {
    return ANSWERED(c, IN_GET_VALUES, get_values(c, vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       const fmi2Real value[]) {
    return ANSWERED(c, IN_SET_REAL, set_values(c, vr, nvr, value));
}

#define NOT_READ_OF(TYPE)                                                                          \
    fmi2Status fmi2Get##TYPE(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,           \
                             fmi2##TYPE value[]) {                                                 \
        (void)vr, (void)value;                                                                     \
        return ANSWERED(c, IN_GET_VALUES, no_variables(c, nvr));                                   \
    }
#define NOT_SET_OF(TYPE)                                                                           \
    fmi2Status fmi2Set##TYPE(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,           \
                             const fmi2##TYPE value[]) {                                           \
        (void)vr, (void)value;                                                                     \
        return ANSWERED(c, IN_SET_DISCRETE, no_variables(c, nvr));                                 \
    }

NOT_READ_OF(Integer)
NOT_READ_OF(String)
NOT_SET_OF(Integer)
NOT_SET_OF(String)
NOT_SET_OF(Boolean)

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Boolean value[]) {
    Instance *self = c;
    if (!allowed(self, IN_GET_VALUES, __func__)) return fmi2Error;
    bool valid = false;
    const Status status = get_validity(self, vr, nvr, value, &valid);
    for (size_t i = 0; status == OK && i < nvr; i++) value[i] = valid;
    return fmi2_status(status);
}

/* -- derivatives with respect to variables ---------------------------------------------------- */

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[],
                                        size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    return ANSWERED(c, IN_GET_DIRECTIONAL_DERIVATIVE,
                    directional(c, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown));
}

/* -- the FMU state ---------------------------------------------------------------------------- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    return ANSWERED(c, IN_FMU_STATE, take_snapshot(c, FMUstate));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    return ANSWERED(c, IN_FMU_STATE, restore_snapshot(c, FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    return ANSWERED(c, IN_FMU_STATE, release_snapshot(c, FMUstate));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    return ANSWERED(c, IN_FMU_STATE, snapshot_size(c, FMUstate, size));
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                 size_t size) {
    return ANSWERED(c, IN_FMU_STATE, serialize(c, FMUstate, serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    return ANSWERED(c, IN_FMU_STATE, deserialize(c, serializedState, size, FMUstate));
}
