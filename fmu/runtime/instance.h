/* One instance of the model, and what the two FMI versions share. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "variables.h"

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility push(hidden) /* only the FMI functions leave the library */
#endif

#if defined __GNUC__
#define PRINTF_LIKE __attribute__((format(printf, 3, 4)))
#else
#define PRINTF_LIKE
#endif

/* Length of an array that a model may not need: C knows no array of length 0. */
#define ROOM(n) ((n) > 0 ? (n) : 1)

/* Numbered as in FMI 2 and FMI 3. */
typedef enum { OK, WARNING, DISCARD, ERROR } Status;

/* The states of the FMI state machines and the two interfaces: bits of masks of what is allowed. */
enum {
    INSTANTIATED = 1 << 0,
    INITIALIZATION_MODE = 1 << 1,
    EVENT_MODE = 1 << 2,
    CONTINUOUS_TIME_MODE = 1 << 3,
    STEP_MODE = 1 << 4, /* FMI 2: step complete */
    STEP_FAILED = 1 << 5,
    TERMINATED = 1 << 6,
    FAULTY = 1 << 7, /* FMI 2: error */
    MODEL_EXCHANGE = 1 << 8,
    CO_SIMULATION = 1 << 9,
    EITHER = MODEL_EXCHANGE | CO_SIMULATION
};

/* Results that a setter made stale, in the order in which they are computed. */
enum {
    START_VALUES = 1 << 0,
    ALGEBRAICS = 1 << 1,
    DERIVATIVES = 1 << 2,
    OUTPUTS = 1 << 3,
    JACOBIAN = 1 << 4,
    AFTER_START = ALGEBRAICS | DERIVATIVES | OUTPUTS | JACOBIAN,
    EVERYTHING = START_VALUES | AFTER_START
};

/* Numbers that the solver of co-simulation goes on from, see integration_dop853.c. */
enum { SOLVER_MEMORY = SOLVER_DOP853 ? 10 * NX + ROOM(NU) + 5 : 0 };

/* All that is needed to continue a run: what the FMI calls the FMU state. No pointer, no padding;
   equal bytes here give equal results ever after. */
typedef struct {
    double values[N_VARIABLES]; /* by value reference */
    double slopes[ROOM(NU)];    /* du/dt within the communication step */
    double memory[ROOM(SOLVER_MEMORY)];
    double stop_time;           /* infinite where none was given */
    double tolerance;           /* relative, of co-simulation */
    uint32_t interface;         /* MODEL_EXCHANGE or CO_SIMULATION */
    uint32_t mode;              /* one of INSTANTIATED ... FAULTY */
    uint32_t stale;             /* of START_VALUES ... JACOBIAN */
    uint32_t experiment_set;    /* start time and tolerance are settled */
    uint32_t slopes_spent;      /* they belong to a step that is over */
    uint32_t step_status;       /* of the last communication step */
} State;

typedef struct Instance Instance;

/* The importer, as far as the shared part must know it. */
typedef struct {
    unsigned fmi_version;
    void (*log)(const Instance *self, Status status, const char *category, const char *text);
    void (*logger)(void); /* the importer's, of a type that `log` knows; may be NULL */
    void *environment;
    void *(*allocate)(size_t count, size_t size); /* zeroed memory or NULL */
    void (*release)(void *memory);
} Host;

struct Instance {
    State state;
    uint64_t magic; /* tells an instance from other memory */
    Host host;
    const char *name;
    const char *function; /* the FMI function that runs, for messages */
    uint32_t categories;  /* log categories that are on, a bit each */
    double *jacobian;     /* of dx, then of z, with respect to x and u; columns */
    const double **arg;   /* work space of the equations */
    double **res;
    long long *iw;
    double *w;
};

/* instance.c: creation, what is allowed when */
Instance *create(const Host *host, const char *function, const char *name, const char *token,
                 unsigned interface, bool logging);
void destroy(Instance *self);
void reset(Instance *self);
bool allowed(Instance *self, unsigned modes, const char *function);
Status set_up(Instance *self, const double *tolerance, double start, const double *stop);
Status finish_initialization(Instance *self);

/* logging.c */
PRINTF_LIKE void log_text(const Instance *self, Status status, const char *format, ...);
PRINTF_LIKE Status refuse(Instance *self, Status status, const char *format, ...);
Status choose_categories(Instance *self, bool on, size_t count, const char *const names[]);

/* evaluation.c: results on demand */
bool all_finite(const double values[], int count);
void pass_values(Instance *self);
Status refresh(Instance *self, unsigned results);

/* access.c: variables by value reference */
Status get_values(Instance *self, const uint32_t references[], size_t count, double values[]);
Status set_values(Instance *self, const uint32_t references[], size_t count,
                  const double values[]);
Status get_block(Instance *self, size_t first, double values[], size_t count);
Status get_nominals(Instance *self, double nominals[], size_t count);
Status set_states(Instance *self, const double x[], size_t count);
Status set_time(Instance *self, double time);
bool known(Instance *self, const uint32_t references[], size_t count);

/* sensitivity.c */
Status directional(Instance *self, const uint32_t unknowns[], size_t n_unknowns,
                   const uint32_t knowns[], size_t n_knowns, const double seed[],
                   double sensitivity[]);
Status time_derivatives(Instance *self, const uint32_t unknowns[], size_t count, double rates[]);

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility pop
#endif

#endif
