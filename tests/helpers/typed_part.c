/* An FMU with arrays and variables of several types, by hand; typed_part.py defines FMI.
 *
 * x' = A x + u, y = x, with n components; n, a structural parameter, may be set in configuration
 * mode only. Inputs of other types pass to outputs of their type; `above` tells whether x[1] >=
 * 0.5, `label` says so in words, and `heard` whether `label_in` says it.
 */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define API __attribute__((visibility("default")))

enum { MOST = 4, SUBSTEPS = 100 };
enum {
    N = 1,
    A,
    U,
    Y,
    X,
    DER_X,
    ON_IN,
    ON,
    COUNT_IN,
    COUNT,
    MODE_IN,
    MODE,
    ABOVE,
    LEVEL_IN,
    LEVEL,
    LABEL_IN,
    LABEL,
    HEARD
};

typedef struct {
    uint64_t n;
    bool configures, on;
    int32_t count;
    int64_t mode;
    float level;
    char label[64];
    double a[MOST * MOST], u[MOST], x[MOST], dx[MOST];
} Instance;

static void start(Instance *self) {
    *self = (Instance){.n = FMI == 3 ? 2 : 1, .count = 1, .mode = 1};
}

static void set_rates(Instance *self) {
    for (size_t i = 0; i < self->n; ++i) {
        self->dx[i] = self->u[i];
        for (size_t k = 0; k < self->n; ++k) self->dx[i] += self->a[i * self->n + k] * self->x[k];
    }
}

static double *reals(Instance *self, unsigned which, size_t *count) {
    *count = which == A ? self->n * self->n : self->n;
    set_rates(self);
    return which == A ? self->a : which == U ? self->u : which == DER_X ? self->dx : self->x;
}

/* Copies variables to or from values; returns an error for another number of values. */
static int copied(Instance *self, const unsigned *which, size_t n, double *values, size_t count,
                  bool sets) {
    size_t done = 0, own;
    for (size_t i = 0; i < n; ++i, done += own) {
        double *place = reals(self, which[i], &own);
        if (done + own > count || (sets && which[i] == Y)) return 3;
        memcpy(sets ? place : values + done, sets ? values + done : place, own * sizeof *place);
    }
    return done == count ? 0 : 3;
}

static int truth(const Instance *self, unsigned which) {
    if (which == HEARD) return strcmp(self->label, "above") == 0;
    return which == ABOVE ? self->x[0] >= 0.5 : self->on;
}

static int get_texts(const Instance *self, const unsigned *which, size_t n, const char **texts) {
    for (size_t i = 0; i < n; ++i)
        texts[i] = which[i] == LABEL_IN ? self->label : truth(self, ABOVE) ? "above" : "below";
    return 0;
}

static int set_text(Instance *self, const char *text) {
    strncpy(self->label, text, sizeof self->label - 1);
    return 0;
}

static void step(Instance *self, double size) {
    const double h = size / SUBSTEPS;
    double x[MOST], sum[MOST];
    for (int i = 0; i < SUBSTEPS; ++i) { /* the classic Runge-Kutta method */
        memcpy(x, self->x, sizeof x);
        memset(sum, 0, sizeof sum);
        for (int stage = 0; stage < 4; ++stage) {
            set_rates(self);
            for (size_t k = 0; k < self->n; ++k) {
                sum[k] += self->dx[k] * (stage == 1 || stage == 2 ? h / 3 : h / 6);
                self->x[k] = x[k] + self->dx[k] * (stage < 2 ? h / 2 : h);
            }
        }
        for (size_t k = 0; k < self->n; ++k) self->x[k] = x[k] + sum[k];
    }
}

#if FMI == 3
API void *fmi3InstantiateModelExchange(void) {
    Instance *self = malloc(sizeof *self);
    if (self) start(self);
    return self;
}
API void *fmi3InstantiateCoSimulation(void) {
    return fmi3InstantiateModelExchange();
}
API void fmi3FreeInstance(void *c) {
    free(c);
}
API int fmi3EnterConfigurationMode(Instance *self) {
    return self->configures = true, 0;
}
API int fmi3ExitConfigurationMode(Instance *self) {
    for (size_t i = 0; i < self->n; ++i)
        self->a[i * self->n + i] = -1; /* other sizes, other values */
    return self->configures = false, 0;
}
API int fmi3GetFloat64(void *c, const unsigned *which, size_t n, double *values, size_t count) {
    return copied(c, which, n, values, count, false);
}
API int fmi3SetFloat64(void *c, const unsigned *which, size_t n, double *values, size_t count) {
    return copied(c, which, n, values, count, true);
}
#define TYPE(NAME, T, GET, SET)                                                                    \
    API int fmi3Get##NAME(Instance *self, const unsigned *which, size_t n, T *v, size_t count) {   \
        for (size_t i = 0; i < n; ++i) v[i] = GET;                                                 \
        return (void)which, n == count ? 0 : 3;                                                    \
    }                                                                                              \
    API int fmi3Set##NAME(Instance *self, const unsigned *which, size_t n, const T *v,             \
                          size_t count) {                                                          \
        for (size_t i = 0; i < n; ++i) SET = v[i];                                                 \
        return (void)which, n == count ? 0 : 3;                                                    \
    }
API int fmi3GetString(void *c, const unsigned *which, size_t n, const char **texts, size_t count) {
    return n == count ? get_texts(c, which, n, texts) : 3;
}
API int fmi3SetString(void *c, const unsigned *which, size_t n, const char **texts, size_t count) {
    return (void)which, n == 1 && count == 1 ? set_text(c, texts[0]) : 3;
}
TYPE(Boolean, bool, truth(self, which[i]), self->on)
TYPE(Int32, int32_t, self->count, self->count)
TYPE(Int64, int64_t, self->mode, self->mode)
TYPE(Float32, float, self->level, self->level)
API int fmi3SetUInt64(Instance *self, const unsigned *which, size_t n, const uint64_t *v) {
    if (!self->configures || n != 1 || v[0] > MOST) return 3;
    return (void)which, self->n = v[0], 0;
}
API int fmi3GetContinuousStates(Instance *self, double *x, size_t n) {
    return memcpy(x, self->x, n * sizeof *x), n == self->n ? 0 : 3;
}
API int fmi3SetContinuousStates(Instance *self, const double *x, size_t n) {
    return memcpy(self->x, x, n * sizeof *x), n == self->n ? 0 : 3;
}
API int fmi3GetContinuousStateDerivatives(Instance *self, double *dx, size_t n) {
    set_rates(self);
    return memcpy(dx, self->dx, n * sizeof *dx), n == self->n ? 0 : 3;
}
API int fmi3GetNominalsOfContinuousStates(Instance *self, double *nominals, size_t n) {
    for (size_t i = 0; i < n; ++i) nominals[i] = 1;
    return n == self->n ? 0 : 3;
}
API int fmi3UpdateDiscreteStates(void *c, bool *needed, bool *ends, bool *nominals, bool *values,
                                 bool *defined, double *time) {
    *needed = *ends = *nominals = *values = *defined = false;
    return (void)c, (void)time, 0;
}
API int fmi3CompletedIntegratorStep(void *c, bool no_rollback, bool *event, bool *ends) {
    *event = *ends = false;
    return (void)c, (void)no_rollback, 0;
}
API int fmi3DoStep(void *c, double time, double size, bool no_rollback, bool *event, bool *ends,
                   bool *early, double *last) {
    step(c, size);
    *event = *ends = *early = false;
    return *last = time + size, (void)no_rollback, 0;
}
#define STATE(NAME) fmi3##NAME##FMUState
#else
API void *fmi2Instantiate(void) {
    Instance *self = malloc(sizeof *self);
    if (self) start(self);
    return self;
}
API void fmi2FreeInstance(void *c) {
    free(c);
}
API int fmi2GetReal(void *c, const unsigned *which, size_t n, double *values) {
    return copied(c, which, n, values, n, false);
}
API int fmi2SetReal(void *c, const unsigned *which, size_t n, double *values) {
    return copied(c, which, n, values, n, true);
}
API int fmi2GetBoolean(Instance *self, const unsigned *which, size_t n, int *values) {
    for (size_t i = 0; i < n; ++i) values[i] = truth(self, which[i]);
    return 0;
}
API int fmi2SetBoolean(Instance *self, const unsigned *which, size_t n, const int *values) {
    for (size_t i = 0; i < n; ++i) self->on = values[i];
    return (void)which, 0;
}
API int fmi2GetInteger(Instance *self, const unsigned *which, size_t n, int *values) {
    for (size_t i = 0; i < n; ++i) values[i] = which[i] < MODE_IN ? self->count : (int)self->mode;
    return 0;
}
API int fmi2SetInteger(Instance *self, const unsigned *which, size_t n, const int *values) {
    for (size_t i = 0; i < n; ++i)
        if (which[i] == COUNT_IN)
            self->count = values[i];
        else
            self->mode = values[i];
    return 0;
}
API int fmi2GetString(void *c, const unsigned *which, size_t n, const char **texts) {
    return get_texts(c, which, n, texts);
}
API int fmi2SetString(void *c, const unsigned *which, size_t n, const char **texts) {
    return (void)which, n == 1 ? set_text(c, texts[0]) : 3;
}
API int fmi2DoStep(void *c, double time, double size) {
    return step(c, size), (void)time, 0;
}
#define STATE(NAME) fmi2##NAME##FMUstate
#endif

API int STATE(Get)(void *c, void **state) {
    if (!*state) *state = malloc(sizeof(Instance));
    return memcpy(*state, c, sizeof(Instance)), 0;
}
API int STATE(Set)(void *c, void *state) {
    return memcpy(c, state, sizeof(Instance)), 0;
}
API int STATE(Free)(void *c, void **state) {
    return (void)c, free(*state), *state = 0, 0;
}
