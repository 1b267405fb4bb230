/* Many instances alive, each driven by a thread of its own: crowd THREADS INSTANCES.
   Every result must have the bits that the same run has alone. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "variables.h"

enum { STEPS = 50 };

typedef struct {
    int number;
    fmi2Component component;
    double values[N_VARIABLES];
} Run;

static void demand(int condition, const char *what) {
    if (condition) return;
    fprintf(stderr, "violated: %s\n", what);
    exit(1);
}

/* No two runs have the same parameter. */
static void create(Run *run) {
    const fmi2CallbackFunctions callbacks = {NULL, calloc, free, NULL, NULL};
    const fmi2ValueReference reference = FIRST_PARAMETER + 1;
    const double value = 1.0 + 0.01 * run->number;
    run->component = fmi2Instantiate("one", fmi2CoSimulation, MODEL_GUID, NULL, &callbacks, 0, 0);
    demand(run->component != NULL, "an instance");
    demand(fmi2SetReal(run->component, &reference, 1, &value) == fmi2OK, "a parameter");
    demand(fmi2SetupExperiment(run->component, 0, 0.0, 0.0, 0, 0.0) == fmi2OK, "an experiment");
    demand(fmi2EnterInitializationMode(run->component) == fmi2OK, "a start");
    demand(fmi2ExitInitializationMode(run->component) == fmi2OK, "a solved start");
}

static void *drive(void *argument) {
    Run *run = argument;
    fmi2ValueReference references[N_VARIABLES];
    for (unsigned i = 0; i < N_VARIABLES; i++) references[i] = i;
    for (int i = 0; i < STEPS; i++) {
        demand(fmi2DoStep(run->component, 0.01 * i, 0.01, 1) == fmi2OK, "a step");
        demand(fmi2GetReal(run->component, references, N_VARIABLES, run->values) == fmi2OK,
               "values");
    }
    return NULL;
}

int main(int argc, char *argv[]) {
    demand(argc == 3, "usage: crowd THREADS INSTANCES");
    const int threads = atoi(argv[1]), count = atoi(argv[2]);
    Run *alone = calloc((size_t)count, sizeof *alone);
    Run *together = calloc((size_t)count, sizeof *together);
    pthread_t *thread = calloc((size_t)threads, sizeof *thread);
    demand(alone && together && thread, "memory");
    for (int i = 0; i < count; i++) {
        alone[i].number = together[i].number = i;
        create(&alone[i]);
        drive(&alone[i]);
        create(&together[i]);
    }
    for (int first = 0; first < count; first += threads) {
        const int batch = count - first < threads ? count - first : threads;
        for (int i = 0; i < batch; i++)
            demand(!pthread_create(&thread[i], NULL, drive, &together[first + i]), "a thread");
        for (int i = 0; i < batch; i++) pthread_join(thread[i], NULL);
    }
    for (int i = 0; i < count; i++) {
        demand(!memcmp(alone[i].values, together[i].values, sizeof alone[i].values), "equal bits");
        demand(i == 0 || memcmp(alone[i].values, alone[i - 1].values, sizeof alone[i].values),
               "different parameters give different results");
        fmi2FreeInstance(alone[i].component);
        fmi2FreeInstance(together[i].component);
    }
    free(alone);
    free(together);
    free(thread);
    printf("%d\n", count);
    return 0;
}
