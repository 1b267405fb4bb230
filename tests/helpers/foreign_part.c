/* A small FMU of FMI 2.0 that others could have written; foreign_part.py defines KIND, DIVIDES,
 * GRID, RESETS, MADE, READY and FAULT. For co-simulation it makes 20 steps of the classic Runge-Kutta method per step.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define API __attribute__((visibility("default")))

enum { INPUT, OUTPUT, STATE };
enum { PLANT, CONTROLLER, LAG, HOLDER };

typedef struct {
    double time, x, u, slope, rate;
    int stepped, is_fatal, ended;
} Instance;

static void *living(void *instance) {
    if (((Instance *)instance)->is_fatal) fputs("a call after a fatal error\n", stderr);
    return instance;
}

static double clip(double value, double limit) {
    return value > limit ? limit : value < -limit ? -limit : value;
}

static void equations(double x, double u, double *dx, double *y) {
    if (KIND == PLANT) {
        *dx = (u + 10) / 3;
        *y = x;
    } else if (KIND == CONTROLLER) { /* proportional and integral, without windup */
        const double raw = x - 100 * u;
        *y = clip(raw, 12);
        *dx = -1000 * u + 100 * (*y - raw);
    } else {
        *dx = KIND == LAG ? u - x : 0;
        *y = x;
    }
}

static double output(const Instance *self) {
    double dx, y;
    equations(self->x, self->u, &dx, &y);
    return y;
}

API const char *fmi2GetTypesPlatform(void) {
    return "default";
}
API const char *fmi2GetVersion(void) {
    return "2.0";
}
API int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const *names) {
    return (void)c, (void)on, (void)n, (void)names, 0;
}
API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *place,
                          const void *functions, int visible, int logging) {
    (void)name, (void)type, (void)guid, (void)place, (void)functions, (void)visible, (void)logging;
    MADE;
    return calloc(1, sizeof(Instance));
}
API void fmi2FreeInstance(void *c) {
    free(living(c));
}
API int fmi2SetupExperiment(void *c, int has, double tolerance, double start, int stops,
                            double end) {
    (void)has, (void)tolerance, (void)stops, (void)end;
    ((Instance *)c)->time = start;
    return 0;
}
API int fmi2EnterInitializationMode(void *c) {
    return (void)c, 0;
}
API int fmi2ExitInitializationMode(void *c) {
    const Instance *self = c;
    (void)self;
    READY;
    return 0;
}
API int fmi2Terminate(void *c) {
    return living(c), 0;
}
API int fmi2Reset(void *c) {
    if (RESETS) memset(living(c), 0, sizeof(Instance));
    return 0;
}

API int fmi2GetReal(void *c, const unsigned *references, size_t n, double *values) {
    const Instance *self = living(c);
    double rate, y;
    equations(self->x, self->u, &rate, &y);
    for (size_t i = 0; i < n; ++i)
        values[i] = references[i] == INPUT    ? self->u
                    : references[i] == OUTPUT ? y
                    : references[i] == STATE  ? self->x
                                              : rate;
    return 0;
}
API int fmi2SetReal(void *c, const unsigned *references, size_t n, const double *values) {
    Instance *self = living(c);
    for (size_t i = 0; i < n; ++i) {
        if (references[i] == OUTPUT) return 3;
        if (references[i] == STATE) self->x = values[i];
        if (references[i] == INPUT) self->u = values[i], self->slope = 0;
    }
    return 0;
}
#define NONE(T, NAME)                                                                              \
    API int fmi2Get##NAME(void *c, const unsigned *references, size_t n, T *values) {              \
        return (void)c, (void)references, (void)values, n ? 3 : 0;                                 \
    }                                                                                              \
    API int fmi2Set##NAME(void *c, const unsigned *references, size_t n, const T *values) {        \
        return (void)c, (void)references, (void)values, n ? 3 : 0;                                 \
    }
NONE(int, Integer)
NONE(int, Boolean)
NONE(const char *, String)

API int fmi2GetFMUstate(void *c, void **state) {
    if (!*state) *state = malloc(sizeof(Instance));
    return memcpy(*state, living(c), sizeof(Instance)), 0;
}
API int fmi2SetFMUstate(void *c, void *state) {
    return memcpy(living(c), state, sizeof(Instance)), 0;
}
API int fmi2FreeFMUstate(void *c, void **state) {
    return living(c), free(*state), *state = 0, 0;
}
API int fmi2SerializedFMUstateSize(void *c, void *state, size_t *n) {
    return (void)c, (void)state, *n = sizeof(Instance), 0;
}
API int fmi2SerializeFMUstate(void *c, void *state, char *bytes, size_t n) {
    return (void)c, memcpy(bytes, state, n), 0;
}
API int fmi2DeSerializeFMUstate(void *c, const char *bytes, size_t n, void **state) {
    (void)c;
    return memcpy(*state = malloc(n), bytes, n), 0;
}
API int fmi2GetDirectionalDerivative(void *c, const unsigned *unknowns, size_t n_unknowns,
                                     const unsigned *knowns, size_t n_knowns, const double *seed,
                                     double *result) {
    const Instance *self = c;
    const double h = 1e-6;
    double dx, above, below;
    equations(self->x, self->u + h, &dx, &above);
    equations(self->x, self->u - h, &dx, &below);
    for (size_t i = 0; i < n_unknowns; ++i) {
        result[i] = 0;
        for (size_t k = 0; k < n_knowns; ++k)
            if (unknowns[i] == OUTPUT && knowns[k] == INPUT)
                result[i] += (above - below) / (2 * h) * seed[k];
    }
    return 0;
}
API int fmi2SetRealInputDerivatives(void *c, const unsigned *references, size_t n,
                                    const int *orders, const double *values) {
    (void)references;
    for (size_t i = 0; i < n; ++i) {
        if (orders[i] != 1) return 3;
        ((Instance *)c)->slope = values[i];
    }
    return 0;
}
API int fmi2GetRealOutputDerivatives(void *c, const unsigned *references, size_t n,
                                     const int *orders, double *values) {
    const Instance *self = c;
    (void)references, (void)orders;
    for (size_t i = 0; i < n; ++i)
        values[i] = self->stepped || !DIVIDES ? self->rate : output(self) / 0.0;
    return 0;
}
API int fmi2DoStep(void *c, double time, double size, int keep) {
    Instance *self = living(c);
    const double h = size / 20, before = output(self), first = self->u;
    double k1, k2, k3, k4, y;
    (void)keep;
    FAULT;
    if (!isfinite(self->u) || !isfinite(self->slope)) return 3;
    for (int i = 0; i < 20; ++i) {
        const double u = first + self->slope * i * h;
        const double middle = u + self->slope * h / 2, last = u + self->slope * h;
        equations(self->x, u, &k1, &y);
        equations(self->x + h / 2 * k1, middle, &k2, &y);
        equations(self->x + h / 2 * k2, middle, &k3, &y);
        equations(self->x + h * k3, last, &k4, &y);
        self->x += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
    }
    if (GRID > 0) self->x = GRID * floor(self->x / GRID + 0.5);
    self->u = first + self->slope * size;
    self->time = time + size;
    self->rate = size > 0 ? (output(self) - before) / size : 0;
    self->stepped = 1;
    return 0;
}
API int fmi2CancelStep(void *c) {
    return (void)c, 3;
}
API int fmi2GetStatus(void *c, int kind, int *value) {
    return (void)c, (void)kind, (void)value, 4;
}
API int fmi2GetRealStatus(void *c, int kind, double *value) {
    (void)kind;
    return *value = ((Instance *)c)->time, 0;
}
API int fmi2GetIntegerStatus(void *c, int kind, int *value) {
    return (void)c, (void)kind, (void)value, 4;
}
API int fmi2GetBooleanStatus(void *c, int kind, int *value) {
    return (void)kind, *value = ((Instance *)c)->ended, 0;
}
API int fmi2GetStringStatus(void *c, int kind, const char **value) {
    return (void)c, (void)kind, (void)value, 4;
}
API int fmi2SetTime(void *c, double time) {
    return ((Instance *)c)->time = time, 0;
}
API int fmi2SetContinuousStates(void *c, const double *x, size_t n) {
    return memcpy(&((Instance *)c)->x, x, n * sizeof *x), 0;
}
API int fmi2GetContinuousStates(void *c, double *x, size_t n) {
    return memcpy(x, &((Instance *)c)->x, n * sizeof *x), 0;
}
API int fmi2GetNominalsOfContinuousStates(void *c, double *x, size_t n) {
    return (void)c, *x = 1, n != 1;
}
API int fmi2GetDerivatives(void *c, double *dx, size_t n) {
    Instance *self = c;
    const double time = self->time, size = 0;
    double y;
    (void)time, (void)size, (void)n;
    FAULT;
    equations(self->x, self->u, dx, &y);
    return 0;
}
API int fmi2GetEventIndicators(void *c, double *z, size_t n) {
    return (void)c, (void)z, n > 0;
}
API int fmi2EnterEventMode(void *c) {
    return (void)c, 0;
}
API int fmi2EnterContinuousTimeMode(void *c) {
    return (void)c, 0;
}
typedef struct {
    int needed, terminate, nominals, values, defined;
    double next;
} EventInfo;
API int fmi2NewDiscreteStates(void *c, EventInfo *info) {
    return (void)c, memset(info, 0, sizeof *info), 0;
}
API int fmi2CompletedIntegratorStep(void *c, int keep, int *event, int *terminate) {
    return (void)c, (void)keep, *event = *terminate = 0, 0;
}
