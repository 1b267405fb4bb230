/* Random calls of every FMI 2 function on a few instances: fuzz_fmi2 SEED CALLS. */
#include "fmi2Functions.h"
#include "fuzz.h"

static _Thread_local struct {
    fmi2Component component;
    fmi2Type type;
    fmi2FMUstate snapshots[SNAPSHOTS];
} pool[INSTANCES];

static _Thread_local long allocated, spoken;

void *__real_calloc(size_t count, size_t size);
void *__real_malloc(size_t size);
void __real_free(void *memory);
void *__wrap_calloc(size_t count, size_t size);
void *__wrap_malloc(size_t size);
void __wrap_free(void *memory);

/* The runtime's memory is its own: the linker puts these before the C library's (--wrap). */
void *__wrap_calloc(size_t count, size_t size) {
    void *memory = one_in(50) ? NULL : __real_calloc(count, size);
    allocated += memory != NULL;
    return memory;
}

void *__wrap_malloc(size_t size) { /* the fuzzer's */
    void *memory = __real_malloc(size);
    allocated += memory != NULL;
    return memory;
}

void __wrap_free(void *memory) {
    allocated -= memory != NULL;
    __real_free(memory);
}

static void *never_allocate(size_t count, size_t size) {
    demand(0, "the importer's functions rest");
    return __real_calloc(count, size);
}

static void never_free(void *memory) {
    demand(memory == NULL, "the importer's functions rest");
}

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment;
    demand(strchr(message, '%') == NULL, "message is a plain text");
    if (status == fmi2OK) {
        demand(strcmp(category, "logEvents") == 0, "what is no event has a reason");
        return;
    }
    spoken += (long)(strlen(name) + strlen(category) + strlen(message) > 0);
}

static void create(unsigned k) {
    if (pool[k].component) return;
    static const char *const names[] = {"one", "%s%n", "", NULL};
    fmi2CallbackFunctions callbacks = {.logger = one_in(9) ? NULL : logger};
    if (!one_in(9)) callbacks.allocateMemory = never_allocate, callbacks.freeMemory = never_free;
    pool[k].type = one_in(2) ? fmi2ModelExchange : fmi2CoSimulation;
    pool[k].component = fmi2Instantiate(
        one_in(9) ? names[below(4)] : "one", pool[k].type, one_in(20) ? "{other}" : MODEL_GUID,
        NULL, one_in(30) ? NULL : &callbacks, (int)below(2), (int)below(2));
}

static void destroy(unsigned k) {
    for (int i = 0; i < SNAPSHOTS; i++) fmi2FreeFMUstate(pool[k].component, &pool[k].snapshots[i]);
    fmi2FreeInstance(pool[k].component);
    pool[k].component = NULL;
}

/* Serialize a snapshot, damage it now and then, and read it back as another. */
static fmi2Status copy_snapshot(fmi2Component c, fmi2FMUstate *from, fmi2FMUstate *to) {
    size_t size = 0;
    if (fmi2SerializedFMUstateSize(c, one_in(20) ? NULL : *from, &size) != fmi2OK) return fmi2Error;
    char *bytes = malloc(size);
    fmi2Status status = fmi2SerializeFMUstate(c, *from, bytes, one_in(9) ? size / 2 : size);
    const int damaged = one_in(3);
    if (status == fmi2OK && damaged) bytes[below((unsigned)size)] ^= (char)(1 << below(8));
    if (status == fmi2OK) {
        fmi2FMUstate copy = NULL;
        status = fmi2DeSerializeFMUstate(c, bytes, one_in(9) ? size / 2 : size, &copy);
        demand(status != fmi2OK || !damaged, "a damaged state is refused");
        if (status == fmi2OK) {
            fmi2FreeFMUstate(c, to);
            *to = copy;
        }
    }
    free(bytes);
    return status;
}

/* The calls that lead on from where an error has left the instance. */
static void lead_on(unsigned k) {
    fmi2Component c = pool[k].component;
    const fmi2ValueReference parameter = FIRST_PARAMETER + below(NP);
    const double value = some_real();
    fmi2Reset(c);
    fmi2SetReal(c, &parameter, 1, &value);
    fmi2SetupExperiment(c, (int)below(2), 1e-6, 0.0, 0, 0.0);
    fmi2EnterInitializationMode(c);
    if (one_in(4) || fmi2ExitInitializationMode(c) != fmi2OK) return;
    if (pool[k].type == fmi2ModelExchange && !one_in(4)) fmi2EnterContinuousTimeMode(c);
}

static fmi2Status read_values(fmi2Component c, Arguments *a) {
    const fmi2Status status = fmi2GetReal(c, a->references, a->n, a->results);
    if (status == fmi2OK && a->results) demand_finite(a->results, a->n);
    return status;
}

static fmi2Status step(fmi2Component c) {
    const fmi2ValueReference time = 0;
    double now = 0;
    if (fmi2GetReal(c, &time, 1, &now) != fmi2OK) return fmi2Error;
    return fmi2DoStep(c, one_in(9) ? some_real() : now,
                      one_in(3) ? some_real() : uniform(0.001, 0.2), (int)below(2));
}

static fmi2Status call_one(unsigned which, unsigned k, Arguments *a) {
    fmi2Component c = one_in(500) ? NULL : pool[k].component;
    fmi2FMUstate *snapshots = pool[k].snapshots;
    double real, *room = one_in(30) ? NULL : &real;
    int flag, other, *flags = one_in(30) ? NULL : &flag;
    fmi2EventInfo info;
    fmi2Status status;
    fmi2String text;
    const char *categories[] = {"logStatusError", "logStatusDiscard", one_in(9) ? "%s" : NULL};
    const size_t length = some_length();
    switch (which) {
    case 0: return fmi2SetDebugLogging(c, (int)below(2), below(4), one_in(9) ? NULL : categories);
    case 1:
        return fmi2SetupExperiment(c, (int)below(2), some_real(), some_real(), (int)below(2),
                                   some_real());
    case 2: return fmi2EnterInitializationMode(c);
    case 3: return fmi2ExitInitializationMode(c);
    case 4: return one_in(20) ? fmi2Terminate(c) : fmi2OK;
    case 5: return fmi2Reset(c);
    case 6: return fmi2GetInteger(c, a->references, a->n / 9, NULL);
    case 7: return fmi2GetBoolean(c, a->references, a->n / 9, NULL);
    case 8: return fmi2GetString(c, a->references, a->n / 9, NULL);
    case 9: return fmi2SetInteger(c, a->references, a->n / 9, NULL);
    case 10: return fmi2SetBoolean(c, a->references, a->n / 9, NULL);
    case 11: return fmi2SetString(c, a->references, a->n / 9, NULL);
    case 12: return fmi2GetFMUstate(c, one_in(30) ? NULL : &snapshots[below(SNAPSHOTS)]);
    case 13: return fmi2SetFMUstate(c, snapshots[below(SNAPSHOTS)]);
    case 14: return fmi2FreeFMUstate(c, one_in(30) ? NULL : &snapshots[below(SNAPSHOTS)]);
    case 15: return copy_snapshot(c, &snapshots[below(SNAPSHOTS)], &snapshots[below(SNAPSHOTS)]);
    case 16: return fmi2SetFMUstate(c, pool[below(INSTANCES)].snapshots[below(SNAPSHOTS)]);
    case 17:
        return fmi2GetDirectionalDerivative(c, a->references, a->n, a->others, a->m, a->values,
                                            a->results);
    case 18: return fmi2EnterEventMode(c);
    case 19: return fmi2NewDiscreteStates(c, one_in(30) ? NULL : &info);
    case 20: return fmi2EnterContinuousTimeMode(c);
    case 21: return fmi2CompletedIntegratorStep(c, 1, flags, one_in(30) ? NULL : &other);
    case 22: return fmi2SetTime(c, some_real());
    case 23: return fmi2SetContinuousStates(c, a->values, length);
    case 24: return fmi2GetEventIndicators(c, a->results, length == NX ? 0 : length);
    case 25: return fmi2GetContinuousStates(c, a->results, length);
    case 26: return fmi2GetDerivatives(c, a->results, length);
    case 27: return fmi2GetNominalsOfContinuousStates(c, a->results, length);
    case 28: return fmi2SetRealInputDerivatives(c, a->references, a->n, a->orders, a->values);
    case 29: return fmi2GetRealOutputDerivatives(c, a->references, a->n, a->orders, a->results);
    case 30: return fmi2CancelStep(c);
    case 31: return fmi2GetStatus(c, (fmi2StatusKind)below(5), one_in(30) ? NULL : &status);
    case 32: return fmi2GetRealStatus(c, (fmi2StatusKind)below(5), room);
    case 33: return fmi2GetIntegerStatus(c, (fmi2StatusKind)below(5), flags);
    case 34: return fmi2GetBooleanStatus(c, (fmi2StatusKind)below(5), flags);
    case 35: return fmi2GetStringStatus(c, (fmi2StatusKind)below(5), one_in(30) ? NULL : &text);
    case 36: return fmi2GetVersion() && fmi2GetTypesPlatform() ? fmi2OK : fmi2Error;
    case 37:
    case 38: return fmi2SetReal(c, a->references, a->n, a->values);
    case 39:
    case 40: return step(c);
    default: return read_values(c, a);
    }
}

static int call(unsigned which, unsigned k, Arguments *a) {
    return (int)call_one(which, k, a);
}

static void settle(void) {
    demand(allocated == 0, "all memory is returned");
    demand(spoken > 0, "the log tells of errors");
}

int main(int argc, char *argv[]) {
    const Interface interface = {43, call, create, destroy, lead_on, settle};
    return fuzz(argc, argv, &interface);
}
