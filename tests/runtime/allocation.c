/* Every allocation fails once, in turn: nothing may crash, nothing may stay behind. The linker puts
   these functions before the C library's (--wrap); the importer's own are never called. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "variables.h"

void *__real_calloc(size_t count, size_t size);
void __real_free(void *memory);
void *__wrap_calloc(size_t count, size_t size);
void __wrap_free(void *memory);

static long granted, in_use, messages;

void *__wrap_calloc(size_t count, size_t size) {
    if (granted-- == 0) return NULL;
    in_use++;
    return __real_calloc(count, size);
}

void __wrap_free(void *memory) {
    in_use -= memory != NULL;
    __real_free(memory);
}

static void *never_allocate(size_t count, size_t size) {
    fprintf(stderr, "violated: the importer's functions rest; %zu of %zu bytes asked\n", count, size);
    exit(1);
}

static void never_free(void *memory) {
    if (memory) exit(1);
}

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment, (void)name, (void)status, (void)category;
    messages += strstr(message, "no memory") != NULL;
}

static void demand(int condition, const char *what) {
    if (condition) return;
    fprintf(stderr, "violated: %s\n", what);
    exit(1);
}

/* A run that saves, serializes and restores; true when all of it went well. */
static int use(void) {
    const fmi2CallbackFunctions callbacks = {logger, never_allocate, never_free, NULL, NULL};
    fmi2Component c =
        fmi2Instantiate("one", fmi2CoSimulation, MODEL_GUID, NULL, &callbacks, 0, 1);
    if (!c) return 0;
    fmi2FMUstate first = NULL, second = NULL;
    char bytes[4096];
    size_t size = 0;
    int well = fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0) == fmi2OK &&
               fmi2EnterInitializationMode(c) == fmi2OK && fmi2ExitInitializationMode(c) == fmi2OK;
    demand(well, "nothing but creation and FMU states needs memory");
    well = fmi2GetFMUstate(c, &first) == fmi2OK;
    demand(fmi2DoStep(c, 0.0, 0.1, 0) == fmi2OK, "a refused FMU state leaves the instance alone");
    well = well && fmi2SerializedFMUstateSize(c, first, &size) == fmi2OK && size <= sizeof bytes &&
           fmi2SerializeFMUstate(c, first, bytes, size) == fmi2OK &&
           fmi2DeSerializeFMUstate(c, bytes, size, &second) == fmi2OK &&
           fmi2SetFMUstate(c, second) == fmi2OK && fmi2DoStep(c, 0.0, 0.1, 0) == fmi2OK;
    fmi2FreeFMUstate(c, &first);
    fmi2FreeFMUstate(c, &second);
    fmi2FreeInstance(c);
    return well;
}

int main(void) {
    int failures = 0, well = 0;
    while (!well) {
        granted = failures;
        messages = 0;
        well = use();
        demand(in_use == 0, "all memory is returned");
        demand(well || messages == 1, "the log tells of the missing memory");
        failures += !well;
    }
    printf("%d\n", failures);
    return 0;
}
