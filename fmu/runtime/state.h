/* The data of one instance: everything that continues a run, and its importer. No functions. */
#ifndef STATE_H
#define STATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "solver_memory.h"
#if HAS_EVENTS
#include "model_laws.h"
#endif

/* Value references and orders of derivatives as FMI declares them: 32 bits, of a type that depends
   on the compiler. */
#ifdef fmi2TypesPlatform_h
typedef fmi2ValueReference Reference;
typedef fmi2Integer Order;
#else
typedef uint32_t Reference;
typedef int32_t Order;
#endif

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
    INTERFACE_ME = 1 << 8,
    INTERFACE_CS = 1 << 9,
    INTERMEDIATE_UPDATE = 1 << 10, /* FMI 3: within a communication step */
    INTERMEDIATE_INPUTS = 1 << 11, /* FMI 3: at its start, while inputs are asked for */
    EITHER = INTERFACE_ME | INTERFACE_CS
};

/* Results that a setter made stale, in the order in which they are computed. */
enum {
    START_VALUES = 1 << 0,
    ALGEBRAICS = 1 << 1,
    DERIVATIVES = 1 << 2,
    OUTPUTS = 1 << 3,
    JACOBIAN = 1 << 4,
    SIDES = 1 << 5, /* of relations, where values were set between steps, or since the last look */
    AFTER_START = ALGEBRAICS | DERIVATIVES | OUTPUTS | JACOBIAN,
    EVERYTHING = START_VALUES | AFTER_START
};

enum { MOST_INPUT_ORDER = 3 }; /* of derivatives of inputs */

/* A look at the rank of the constraints: their distance from losing it, 1 at best. */
typedef struct {
    double time, distance, rate;
    double x[ROOM(NX)], dx[ROOM(NX)];
} Look;

/* The last two looks; all of it doubles. */
typedef struct {
    double looks; /* how many of them there are */
    Look last, before;
    double least,
        when; /* distance of what was evaluated since and is nearest to a loss; its time */
} Watch;

#if HAS_EVENTS
/* The instance before an event at a communication point; all of it doubles. */
typedef struct {
    double known; /* 1: there was one; 3: it has happened again; -1: it does so; 2: in event mode,
                     only modes */
    double time, x[ROOM(NX)], modes[ROOM(MODES)], inputs[ROOM(NU)];
    Switching switching;
} Before;

/* What the next step begins with, while results are on the sides that set values require; all of it
   doubles. */
typedef struct {
    double known, modes[ROOM(MODES)]; /* known: 1 while they are */
    Switching switching;
} Aside;
#endif

#if HAS_LOOKS
/* The instance at a point of an importer of model exchange. */
typedef struct {
    double time, x[ROOM(NX)], dx[ROOM(NX)], u[ROOM(NU)];
    double inside[ROOM(MODES)]; /* by how much relations are within their modes, at least */
} Glance;

/* Its last two points since the last event; all of it doubles. */
typedef struct {
    double count; /* how many of them there are */
    Glance last, before;
    double seen;                /* 1: the limits between them have been warned of */
    double relation, left;      /* 1 + one that has left its mode between them, and when; 0: none */
    double warned[ROOM(MODES)]; /* 1: its passing has been logged */
} Looks;
#endif

#if HAS_LEAPS
/* The inputs before the last two leaps; all of it doubles. */
typedef struct {
    double count; /* how many are known */
    double u[2][NU - MODES];
} Leaps;
#endif

/* All that is needed to continue a run: what the FMI calls the FMU state. No pointer, no padding;
   equal bytes here give equal results ever after. */
typedef struct {
    double values[N_VARIABLES]; /* by value reference */
    /* derivatives of the inputs by time, from the first on, within the communication step */
    double motion[MOST_INPUT_ORDER][ROOM(NU)];
    double departure[ROOM(NU)]; /* second derivatives of inputs that leave a rest within the step */
    double guesses[ROOM(NX)];   /* where the solution of calculated start values begins */
    double reached[ROOM(NZ)];   /* algebraic unknowns at the end of the last communication step */
    SolverMemory memory;
#if HAS_RANK
    Watch watch;
#endif
#if HAS_EVENTS
    Switching switching;
    Before before;
    Aside aside;
#endif
#if HAS_LOOKS
    Looks looks;
#endif
#if HAS_LEAPS
    Leaps leaps;
#endif
    double widest[ROOM(N_LIMITS)];  /* margin of each limit so far: what it is measured by */
    double left[ROOM(N_LIMITS)];    /* last communication step outside each limit, from 1 on */
    double outside[ROOM(N_LIMITS)]; /* of each limit: 1 if it is left, or 0 */
    double stop_time;               /* infinite where none was given */
    double tolerance;               /* relative, of co-simulation */
    double steps;                   /* of communication, taken since the start */
    uint32_t interface;             /* INTERFACE_ME or INTERFACE_CS */
    uint32_t mode;                  /* one of INSTANTIATED ... INTERMEDIATE_INPUTS */
    uint32_t stale;                 /* of START_VALUES ... SIDES */
    uint32_t experiment_set;        /* start time and tolerance are settled */
    uint32_t motion_spent;          /* the inputs' derivatives belong to a step that is over */
    uint32_t step_status;           /* of the last communication step */
    uint32_t retuned;               /* a parameter has changed since the last one */
    uint32_t violated;              /* how many limits of the model are left */
} State;

#if BOUNDED_LIMITS > 0
/* A box of states and a span of time within which bounds have proven that limits hold: those that
   have bounds, with these modes and parameters. */
typedef struct {
    double begin, end, low[ROOM(NX)], high[ROOM(NX)], given[ROOM(MODES + NP)];
    double outside[ROOM(N_LIMITS)]; /* limits that had been left before */
    bool known;
} Proven;
#endif

typedef struct Instance Instance;

/* The importer, as far as the shared part must know it. */
typedef struct {
    unsigned fmi_version;
    void (*log)(const Instance *self, Status status, const char *category, const char *text);
    void (*logger)(void); /* the importer's, of a type that `log` knows; may be NULL */
    void *environment;
    bool (*step_finished)(Instance *self, double *end); /* may bring the end forward; or NULL */
    bool (*ask_inputs)(Instance *self, double time);    /* for those of a time ahead; or NULL */
    void (*update)(void);              /* the importer's, of a type that these two know */
    bool may_return_early, event_mode; /* of co-simulation */
} Host;

struct Instance {
    State state;
    uint64_t magic; /* tells an instance from other memory */
    Host host;
    const char *name;
    const char *function; /* the FMI function that runs, for messages */
    bool stepping;        /* within a communication step */
    uint32_t categories;  /* log categories that are on, a bit each */
    double *jacobian;     /* of dx, then of z, with respect to x and u; columns */
    const double **arg;   /* work space of the equations */
    double **res;
    long long *iw;
    double *w;
    double constants[ROOM(NC)]; /* the parameters, and what depends on parameters alone */
#if BOUNDED_LIMITS > 0
    Proven proven; /* saves bounds, and changes no result */
#endif
#if HAS_EVENTS
    LawOwner laws;
    double sizes[ROOM(NX)];  /* of the states */
    bool leapt[ROOM(MODES)]; /* a leap of inputs over it has been logged */
#endif
};

#endif
