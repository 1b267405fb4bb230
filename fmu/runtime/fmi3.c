/* FMI 3.0: the functions common to model exchange and co-simulation. */
#include "fmi3.h"
#include "access.h"
#include "derivatives.h"
#include "initialization.h"
#include "snapshot.h"

/* -- information, creation, logging ----------------------------------------------------------- */

const char *fmi3GetVersion(void) {
    return fmi3Version;
}

static void log_fmi3(const Instance *self, Status status, const char *category, const char *text) {
    const fmi3LogMessageCallback logger = (fmi3LogMessageCallback)self->host.logger;
    logger(self->host.environment, fmi3_status(status), category, text);
}

static Host host_of(fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger) {
    return (Host){
        .fmi_version = 3,
        .log = log_fmi3,
        .logger = (void (*)(void))logger,
        .environment = environment,
    };
}

/* Call the importer back in a mode; false where it has called what it must not. */
static bool call_back(Instance *self, uint32_t mode, double time, fmi3Boolean *stops,
                      fmi3Float64 *wanted) {
    const fmi3IntermediateUpdateCallback update = (fmi3IntermediateUpdateCallback)self->host.update;
    const char *function = self->function;
    const bool finished = mode == INTERMEDIATE_UPDATE;
    self->state.mode = mode;
    update(self->host.environment, time, !finished, finished, finished,
           finished && self->host.may_return_early, stops, wanted);
    if (self->state.mode != mode) return false;
    self->state.mode = STEP_MODE;
    self->function = function;
    return true;
}

/* Between communication points the importer may read variables, and wish to stop there. */
static bool intermediate_update(Instance *self, double *end) {
    const double now = self->state.values[TIME];
    fmi3Boolean stops = fmi3False;
    fmi3Float64 wanted = now;
    if (!call_back(self, INTERMEDIATE_UPDATE, now, &stops, &wanted)) return false;
    if (stops && self->host.may_return_early && wanted < *end) *end = wanted > now ? wanted : now;
    return true;
}

static bool ask_inputs(Instance *self, double time) {
    fmi3Boolean stops = fmi3False;
    fmi3Float64 wanted = time;
    return call_back(self, INTERMEDIATE_INPUTS, time, &stops, &wanted);
}

/* The resources are not needed and not read; nothing is ever visible. */
fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible,
                                          fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage) {
    (void)resourcePath, (void)visible;
    const Host host = host_of(instanceEnvironment, logMessage);
    return create(&host, __func__, instanceName, instantiationToken, INTERFACE_ME, loggingOn);
}

/* Without event mode, or early return, events happen within a communication step. All variables can
   be read between communication points; inputs are asked for if one of them is among the required
   variables. */
fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
    fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate) {
    (void)resourcePath, (void)visible;
    Host host = host_of(instanceEnvironment, logMessage);
    host.step_finished = intermediateUpdate ? intermediate_update : NULL;
    host.update = (void (*)(void))intermediateUpdate;
    host.may_return_early = earlyReturnAllowed;
    const Instance draft = {.host = host, .name = "", .function = __func__, .categories = ~0u};
    if (nRequiredIntermediateVariables > 0 && !requiredIntermediateVariables) {
        log_text(&draft, ERROR, "%zu required variables, but no list",
                 nRequiredIntermediateVariables);
        return NULL;
    }
    for (size_t i = 0; i < nRequiredIntermediateVariables; i++) {
        const fmi3ValueReference reference = requiredIntermediateVariables[i];
        if (reference < N_VARIABLES && variables[reference].role == INPUT && intermediateUpdate)
            host.ask_inputs = ask_inputs;
    }
    host.event_mode = eventModeUsed;
    if (eventModeUsed && MODES == 0) {
        log_text(&draft, ERROR, "the model has no events: instantiate with eventModeUsed = false");
        return NULL;
    }
    return create(&host, __func__, instanceName, instantiationToken, INTERFACE_CS, loggingOn);
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
    fmi3LockPreemptionCallback lockPreemption, fmi3UnlockPreemptionCallback unlockPreemption) {
    (void)resourcePath, (void)visible, (void)clockUpdate, (void)lockPreemption;
    (void)unlockPreemption;
    const Host host = host_of(instanceEnvironment, logMessage);
    return create(&host, __func__, instanceName, instantiationToken, 0, loggingOn);
}

void fmi3FreeInstance(fmi3Instance instance) {
    destroy(instance);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[]) {
    return ANSWERED(instance, IN_SET_DEBUG_LOGGING,
                    choose_categories(instance, loggingOn, nCategories, categories));
}

/* -- initialization, termination, reset ------------------------------------------------------- */

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    Instance *self = instance;
    if (!allowed(self, IN_ENTER_INITIALIZATION_MODE, __func__)) return fmi3Error;
    const Status status = set_up(self, toleranceDefined ? &tolerance : NULL, startTime,
                                 stopTimeDefined ? &stopTime : NULL);
    if (status != ERROR) self->state.mode = INITIALIZATION_MODE;
    return fmi3_status(status);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    return ANSWERED(instance, IN_EXIT_INITIALIZATION_MODE, finish_initialization(instance));
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    return ANSWERED(instance, IN_TERMINATE, enter(instance, TERMINATED));
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    if (!allowed(instance, IN_RESET, __func__)) return fmi3Error;
    reset(instance);
    return fmi3OK;
}

/* -- variables: all are Float64 scalars ------------------------------------------------------- */

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Float64 values[], size_t nValues) {
    Instance *self = instance;
    if (!allowed(self, IN_GET_VALUES, __func__)) return fmi3Error;
    if (!one_each(self, nValues, nValueReferences)) return fmi3Error;
    return fmi3_status(get_values(self, valueReferences, nValueReferences, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Float64 values[], size_t nValues) {
    Instance *self = instance;
    if (!allowed(self, IN_SET_FLOAT, __func__)) return fmi3Error;
    if (!one_each(self, nValues, nValueReferences)) return fmi3Error;
    return fmi3_status(set_values(self, valueReferences, nValueReferences, values));
}

/* The one variable of another type is `valid`. */
fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Boolean values[], size_t nValues) {
    Instance *self = instance;
    if (!allowed(self, IN_GET_VALUES, __func__)) return fmi3Error;
    if (HAS_VALID && !one_each(self, nValues, nValueReferences)) return fmi3Error;
    bool valid = false;
    const Status status = get_validity(self, valueReferences, nValueReferences, values, &valid);
    for (size_t i = 0; status == OK && i < nValueReferences; i++) values[i] = valid;
    return fmi3_status(status);
}

/* -- derivatives with respect to variables ---------------------------------------------------- */

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                        size_t nUnknowns, const fmi3ValueReference knowns[],
                                        size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                        fmi3Float64 sensitivity[], size_t nSensitivity) {
    Instance *self = instance;
    if (!allowed(self, IN_GET_DERIVATIVE, __func__)) return fmi3Error;
    if (!one_each(self, nSeed, nKnowns) || !one_each(self, nSensitivity, nUnknowns))
        return fmi3Error;
    return fmi3_status(directional(self, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity));
}

/* -- the FMU state ---------------------------------------------------------------------------- */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    return ANSWERED(instance, IN_FMU_STATE, take_snapshot(instance, FMUState));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState) {
    return ANSWERED(instance, IN_FMU_STATE, restore_snapshot(instance, FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    return ANSWERED(instance, IN_FMU_STATE, release_snapshot(instance, FMUState));
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size) {
    return ANSWERED(instance, IN_FMU_STATE, snapshot_size(instance, FMUState, size));
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState,
                                 fmi3Byte serializedState[], size_t size) {
    return ANSWERED(instance, IN_FMU_STATE, serialize(instance, FMUState, serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[],
                                   size_t size, fmi3FMUState *FMUState) {
    return ANSWERED(instance, IN_FMU_STATE, deserialize(instance, serializedState, size, FMUState));
}
