/* Random calls of FMI 3 functions on a few instances: fuzz_fmi3 SEED CALLS. */
#include "fmi3Functions.h"
#include "fuzz.h"

static _Thread_local struct {
    fmi3Instance instance;
    int steps;  /* co-simulation */
    int events; /* with event mode */
    fmi3FMUState snapshots[SNAPSHOTS];
} pool[INSTANCES];

static _Thread_local long spoken;

static void logger(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                   fmi3String message) {
    (void)environment;
    demand(strchr(message, '%') == NULL, "message is a plain text");
    if (status == fmi3OK) {
        demand(strcmp(category, "logEvents") == 0, "what is no event has a reason");
        return;
    }
    spoken += (long)(strlen(category) + strlen(message) > 0);
}

/* Gives inputs, finite or not, where they are asked for; calls now and then what it must not. */
static void update(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean asked,
                   fmi3Boolean readable, fmi3Boolean finished, fmi3Boolean may_return,
                   fmi3Boolean *stops, fmi3Float64 *until) {
    const unsigned k = (unsigned)(size_t)environment;
    const fmi3ValueReference input = FIRST_INPUT + below(NU);
    const double value = one_in(9) ? some_real() : uniform(-1, 1);
    double read;
    demand(asked != finished && readable == finished && !(asked && may_return), "either of two");
    if (one_in(20)) fmi3SetDebugLogging(pool[k].instance, one_in(2), 0, NULL);
    if (one_in(200)) fmi3Reset(pool[k].instance);
    if (asked || one_in(200)) fmi3SetFloat64(pool[k].instance, &input, 1, &value, 1);
    if (readable || one_in(200)) fmi3GetFloat64(pool[k].instance, &input, 1, &read, 1);
    if (may_return && one_in(9)) *until = one_in(9) ? some_real() : time;
    *stops = may_return && one_in(9);
}

static void create(unsigned k) {
    if (pool[k].instance) return;
    const char *name = one_in(20) ? "" : "one", *token = one_in(20) ? "{other}" : MODEL_GUID;
    fmi3LogMessageCallback log = one_in(9) ? NULL : logger;
    const fmi3ValueReference wanted[] = {one_in(9) ? some_reference() : FIRST_INPUT, TIME};
    pool[k].steps = (int)below(2);
    if (one_in(50))
        pool[k].instance = fmi3InstantiateScheduledExecution(name, token, NULL, false, true, NULL,
                                                             log, NULL, NULL, NULL);
    else if (pool[k].steps) {
        pool[k].events = one_in(MODES > 0 ? 2 : 30);
        pool[k].instance =
            fmi3InstantiateCoSimulation(name, token, NULL, false, one_in(2), pool[k].events,
                                        one_in(2), one_in(50) ? NULL : wanted, below(3),
                                        (void *)(size_t)k, log, one_in(2) ? update : NULL);
    } else
        pool[k].instance =
            fmi3InstantiateModelExchange(name, token, NULL, false, one_in(2), NULL, log);
}

static void destroy(unsigned k) {
    for (int i = 0; i < SNAPSHOTS; i++) fmi3FreeFMUState(pool[k].instance, &pool[k].snapshots[i]);
    fmi3FreeInstance(pool[k].instance);
    pool[k].instance = NULL;
}

/* Serialize a snapshot, damage it now and then, and read it back as another. */
static fmi3Status copy_snapshot(fmi3Instance c, fmi3FMUState *from, fmi3FMUState *to) {
    size_t size = 0;
    if (fmi3SerializedFMUStateSize(c, *from, &size) != fmi3OK) return fmi3Error;
    fmi3Byte *bytes = malloc(size);
    fmi3Status status = fmi3SerializeFMUState(c, *from, bytes, size);
    const int damaged = one_in(3);
    if (damaged) bytes[below((unsigned)size)] ^= (fmi3Byte)(1 << below(8));
    fmi3FMUState copy = NULL;
    if (status == fmi3OK) status = fmi3DeserializeFMUState(c, bytes, size, &copy);
    demand(status != fmi3OK || !damaged, "a damaged state is refused");
    if (status == fmi3OK) {
        fmi3FreeFMUState(c, to);
        *to = copy;
    }
    free(bytes);
    return status;
}

/* The calls that lead on from where an error has left the instance. */
static void lead_on(unsigned k) {
    fmi3Instance c = pool[k].instance;
    const fmi3ValueReference parameter = FIRST_PARAMETER + below(NP);
    const double value = some_real();
    fmi3Reset(c);
    fmi3SetFloat64(c, &parameter, 1, &value, 1);
    fmi3EnterInitializationMode(c, one_in(2), 1e-6, 0.0, false, 0.0);
    if (one_in(4) || fmi3ExitInitializationMode(c) != fmi3OK) return;
    if (!pool[k].steps && !one_in(4)) fmi3EnterContinuousTimeMode(c);
    if (pool[k].steps && pool[k].events && !one_in(4)) fmi3EnterStepMode(c);
}

static fmi3Status read_values(fmi3Instance c, Arguments *a) {
    const size_t values = one_in(30) ? a->n + 1 : a->n;
    const fmi3Status status = fmi3GetFloat64(c, a->references, a->n, a->results, values);
    if (status == fmi3OK && a->results) demand_finite(a->results, a->n);
    return status;
}

static fmi3Status step(fmi3Instance c) {
    const fmi3ValueReference time = 0;
    double now = 0, reached = 0;
    bool event = true, end = true, early = true;
    if (fmi3GetFloat64(c, &time, 1, &now, 1) != fmi3OK) return fmi3Error;
    const fmi3Status status =
        fmi3DoStep(c, one_in(9) ? some_real() : now, one_in(3) ? some_real() : uniform(0.001, 0.2),
                   one_in(2), &event, &end, one_in(40) ? NULL : &early, &reached);
    if (status == fmi3OK)
        demand((!event || MODES) && (!end || EVENTS) && !(early && end) && reached >= now,
               "a plain step");
    if (status == fmi3Discard) demand(reached == now, "a discarded step leaves time alone");
    return status;
}

static fmi3Status differentiate(fmi3Instance c, Arguments *a, int backwards) {
    const size_t seeds = backwards ? a->n : a->m, results = backwards ? a->m : a->n;
    const size_t given = one_in(30) ? seeds / 2 : seeds;
    return backwards ? fmi3GetAdjointDerivative(c, a->references, a->n, a->others, a->m, a->values,
                                                given, a->results, results)
                     : fmi3GetDirectionalDerivative(c, a->references, a->n, a->others, a->m,
                                                    a->values, given, a->results, results);
}

static fmi3Status call_one(unsigned which, unsigned k, Arguments *a) {
    fmi3Instance c = one_in(500) ? NULL : pool[k].instance;
    fmi3FMUState *snapshots = pool[k].snapshots;
    double next;
    size_t number;
    bool flag[5], *flags = one_in(30) ? NULL : flag;
    const char *categories[] = {"logStatusError", "logStatusDiscard", one_in(9) ? "%s" : NULL};
    const size_t length = some_length(), few = a->n / 9;
    switch (which) {
    case 0: return fmi3SetDebugLogging(c, one_in(2), below(4), one_in(9) ? NULL : categories);
    case 1:
        return fmi3EnterInitializationMode(c, one_in(2), some_real(), some_real(), one_in(2),
                                           some_real());
    case 2: return fmi3ExitInitializationMode(c);
    case 3: return fmi3EnterEventMode(c);
    case 4: return one_in(20) ? fmi3Terminate(c) : fmi3OK;
    case 5: return fmi3Reset(c);
    case 6: return fmi3GetInt8(c, a->references, few, NULL, few);
    case 7: return fmi3SetUInt64(c, a->references, few, NULL, few);
    case 8: return fmi3GetBoolean(c, a->references, few, NULL, few);
    case 9: return fmi3SetBinary(c, a->references, few, NULL, NULL, few);
    case 10: return fmi3GetClock(c, a->references, few, NULL);
    case 11: return fmi3SetClock(c, a->references, few, NULL);
    case 12: return fmi3GetIntervalDecimal(c, a->references, few, NULL, NULL);
    case 13: return fmi3SetShiftFraction(c, a->references, few, NULL, NULL);
    case 14: return fmi3GetNumberOfVariableDependencies(c, some_reference(), &number);
    case 15: return fmi3GetVariableDependencies(c, 0, NULL, NULL, NULL, NULL, length);
    case 16: return fmi3EnterConfigurationMode(c);
    case 17: return fmi3ExitConfigurationMode(c);
    case 18: return fmi3ActivateModelPartition(c, some_reference(), some_real());
    case 19: return fmi3GetFMUState(c, one_in(30) ? NULL : &snapshots[below(SNAPSHOTS)]);
    case 20: return fmi3SetFMUState(c, snapshots[below(SNAPSHOTS)]);
    case 21: return fmi3FreeFMUState(c, one_in(30) ? NULL : &snapshots[below(SNAPSHOTS)]);
    case 22: return copy_snapshot(c, &snapshots[below(SNAPSHOTS)], &snapshots[below(SNAPSHOTS)]);
    case 23: return fmi3SetFMUState(c, pool[below(INSTANCES)].snapshots[below(SNAPSHOTS)]);
    case 24:
    case 25: return differentiate(c, a, which == 25);
    case 26: return fmi3EvaluateDiscreteStates(c);
    case 27:
        return fmi3UpdateDiscreteStates(c, flags, flag + 1, flag + 2, flag + 3, flag + 4, &next);
    case 28: return fmi3EnterContinuousTimeMode(c);
    case 29: return fmi3CompletedIntegratorStep(c, true, flag, flags);
    case 30: return fmi3SetTime(c, some_real());
    case 31: return fmi3SetContinuousStates(c, a->values, length);
    case 32: return fmi3GetContinuousStates(c, a->results, length);
    case 33: return fmi3GetContinuousStateDerivatives(c, a->results, length);
    case 34: return fmi3GetNominalsOfContinuousStates(c, a->results, length);
    case 35: return fmi3GetEventIndicators(c, a->results, length == NX ? 0 : length);
    case 36: return fmi3GetNumberOfEventIndicators(c, one_in(30) ? NULL : &number);
    case 37: return fmi3GetNumberOfContinuousStates(c, &number);
    case 38: return fmi3EnterStepMode(c);
    case 39: return fmi3GetOutputDerivatives(c, a->references, a->n, a->orders, a->results, a->n);
    case 40:
    case 41: return fmi3SetFloat64(c, a->references, a->n, a->values, a->n);
    case 42:
    case 43: return step(c);
    default: return read_values(c, a);
    }
}

static int call(unsigned which, unsigned k, Arguments *a) {
    return (int)call_one(which, k, a);
}

static void settle(void) {
    demand(spoken > 0, "the log tells of errors");
}

int main(int argc, char *argv[]) {
    const Interface interface = {46, call, create, destroy, lead_on, settle};
    return fuzz(argc, argv, &interface);
}
