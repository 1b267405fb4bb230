/* A ball that falls and bounces, for model exchange, by hand and without anybody's headers.
 *
 * It falls from 1 m; at 0.25 s, a time event, it is pushed upward; where it meets the ground, an
 * event of the states, 0.7 of its speed is left. After `limit` bounces it ends the simulation.
 * Variables: 1 h, 2 v, 3 der(h), 4 der(v), 5 bounces (integer), 6 pushed (Boolean), 7 limit.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>

enum { H = 1, V, DER_H, DER_V, BOUNCES, PUSHED, LIMIT };
typedef struct {
    double t, h, v, limit;
    int bounces;
    bool pushed;
} Ball;

static void start(Ball *self) {
    *self = (Ball){.h = 1, .limit = 1e9};
}

static double real_of(const Ball *self, unsigned which) {
    switch (which) {
    case H: return self->h;
    case V: case DER_H: return self->v;
    case DER_V: return -9.81;
    default: return self->limit;
    }
}

/* Whether it wants to end. */
static bool event(Ball *self) {
    if (self->h <= 0 && self->v < 0) {
        self->v *= -0.7;
        ++self->bounces;
    }
    if (!self->pushed && self->t >= 0.25) {
        self->pushed = true;
        self->v += 2;
    }
    return self->bounces >= self->limit;
}

#define REALS(name, ...)                                                                           \
    int name(Ball *self, const unsigned *which, size_t n, double *values __VA_ARGS__)
#define SET_STATES(name)                                                                           \
    int name(Ball *self, const double *x, size_t n) {                                              \
        (void)n;                                                                                   \
        self->h = x[0];                                                                            \
        self->v = x[1];                                                                            \
        return 0;                                                                                  \
    }
#define GET_STATES(name)                                                                           \
    int name(Ball *self, double *x, size_t n) {                                                    \
        (void)n;                                                                                   \
        x[0] = self->h;                                                                            \
        x[1] = self->v;                                                                            \
        return 0;                                                                                  \
    }
#define DERIVATIVES(name)                                                                          \
    int name(Ball *self, double *dx, size_t n) {                                                   \
        (void)n;                                                                                   \
        dx[0] = self->v;                                                                           \
        dx[1] = -9.81;                                                                             \
        return 0;                                                                                  \
    }
#define INDICATORS(name)                                                                           \
    int name(Ball *self, double *z, size_t n) {                                                    \
        (void)n;                                                                                   \
        z[0] = self->h;                                                                            \
        return 0;                                                                                  \
    }
#define NOMINALS(name)                                                                             \
    int name(Ball *self, double *x, size_t n) {                                                    \
        (void)self, (void)n;                                                                       \
        x[0] = x[1] = 1;                                                                           \
        return 0;                                                                                  \
    }
#define SET_TIME(name)                                                                             \
    int name(Ball *self, double t) {                                                               \
        self->t = t;                                                                               \
        return 0;                                                                                  \
    }

#if FMI == 2
void *fmi2Instantiate(void) {
    Ball *self = malloc(sizeof *self);
    start(self);
    return self;
}
void fmi2FreeInstance(Ball *self) {
    free(self);
}
int fmi2Reset(Ball *self) {
    start(self);
    return 0;
}
REALS(fmi2GetReal) {
    for (size_t i = 0; i < n; ++i) values[i] = real_of(self, which[i]);
    return 0;
}
int fmi2SetReal(Ball *self, const unsigned *which, size_t n, const double *values) {
    for (size_t i = 0; i < n; ++i)
        if (which[i] == LIMIT) self->limit = values[i];
    return 0;
}
int fmi2GetInteger(Ball *self, const unsigned *which, size_t n, int *values) {
    (void)which;
    for (size_t i = 0; i < n; ++i) values[i] = self->bounces;
    return 0;
}
int fmi2GetBoolean(Ball *self, const unsigned *which, size_t n, int *values) {
    (void)which;
    for (size_t i = 0; i < n; ++i) values[i] = self->pushed;
    return 0;
}
int fmi2NewDiscreteStates(Ball *self, void *info) {
    int *flags = info;
    flags[0] = flags[2] = 0;
    flags[1] = event(self);
    flags[3] = 1;
    flags[4] = !self->pushed;
    *(double *)((char *)info + 24) = 0.25;
    return 0;
}
int fmi2CompletedIntegratorStep(Ball *self, int keep, int *enter, int *end) {
    (void)self, (void)keep;
    *enter = *end = 0;
    return 0;
}
SET_TIME(fmi2SetTime)
SET_STATES(fmi2SetContinuousStates)
GET_STATES(fmi2GetContinuousStates)
DERIVATIVES(fmi2GetDerivatives)
INDICATORS(fmi2GetEventIndicators)
NOMINALS(fmi2GetNominalsOfContinuousStates)
#else
void *fmi3InstantiateModelExchange(void) {
    Ball *self = malloc(sizeof *self);
    start(self);
    return self;
}
void fmi3FreeInstance(Ball *self) {
    free(self);
}
int fmi3Reset(Ball *self) {
    start(self);
    return 0;
}
REALS(fmi3GetFloat64, , size_t m) {
    for (size_t i = 0; i < n && i < m; ++i) values[i] = real_of(self, which[i]);
    return 0;
}
int fmi3SetFloat64(Ball *self, const unsigned *which, size_t n, const double *values, size_t m) {
    for (size_t i = 0; i < n && i < m; ++i)
        if (which[i] == LIMIT) self->limit = values[i];
    return 0;
}
int fmi3GetInt32(Ball *self, const unsigned *which, size_t n, int *values, size_t m) {
    (void)which;
    for (size_t i = 0; i < n && i < m; ++i) values[i] = self->bounces;
    return 0;
}
int fmi3GetBoolean(Ball *self, const unsigned *which, size_t n, bool *values, size_t m) {
    (void)which;
    for (size_t i = 0; i < n && i < m; ++i) values[i] = self->pushed;
    return 0;
}
int fmi3UpdateDiscreteStates(Ball *self, bool *needed, bool *end, bool *nominals, bool *values,
                             bool *defined, double *next) {
    *needed = *nominals = false;
    *values = true;
    *end = event(self);
    *defined = !self->pushed;
    *next = 0.25;
    return 0;
}
int fmi3CompletedIntegratorStep(Ball *self, bool keep, bool *enter, bool *end) {
    (void)self, (void)keep;
    *enter = *end = false;
    return 0;
}
SET_TIME(fmi3SetTime)
SET_STATES(fmi3SetContinuousStates)
GET_STATES(fmi3GetContinuousStates)
DERIVATIVES(fmi3GetContinuousStateDerivatives)
INDICATORS(fmi3GetEventIndicators)
NOMINALS(fmi3GetNominalsOfContinuousStates)
#endif
