/* The variables of a model; model.h and the table are generated, one entry per value reference:
   time, states, derivatives, algebraic unknowns, inputs and modes, parameters, outputs. */
#ifndef VARIABLES_H
#define VARIABLES_H

#include <stdbool.h>

#include "model.h"
#include "visibility.h"

/* Length of an array that a model may not need: C knows no array of length 0. */
#define ROOM(n) ((n) > 0 ? (n) : 1)

#if defined N_MODES
#define HAS_EVENTS 1
#else /* modes, those that are watched for a crossing, events, states that these assign */
#define HAS_EVENTS 0
#define N_MODES 0
#define N_WATCHED 0
#define N_EVENTS 0
#define N_ASSIGNED 0
#endif
#if !defined N_PULSES
#define N_PULSES 0
#endif
#if !defined N_BOUNDED /* relations that are not linear in time and have bounds */
#define N_BOUNDED 0
#endif

typedef enum { TIME, STATE, DERIVATIVE, ALGEBRAIC, INPUT, MODE, PARAMETER, OUTPUT } Role;

/* How a start value comes about: given, calculated from others, or the guess of a solution. */
typedef enum { EXACT, CALCULATED, GUESS } StartKind;

typedef struct {
    const char *name;
    Role role;
    StartKind start_kind;
    double start; /* of a calculated state: what it comes to, about */
    double nominal, minimum, maximum;
    double guess; /* of a calculated state: where its solution begins */
    bool tunable; /* a parameter that may change during a run */
} VariableInfo;

/* What switches: its mode is the sign of its argument, or the floor. */
typedef struct {
    const char *name;
    bool floor;
    bool of_time;      /* its argument depends on time and parameters alone ... */
    bool linear;       /* ... and is linear in time */
    bool of_input;     /* it depends on inputs, or on unknowns that may do so */
    int at_zero;       /* mode while the argument stays 0; 0: the one that it has */
    bool in_equations; /* not only in conditions of events */
} RelationInfo;

/* What happens where a condition becomes true. */
typedef struct {
    const char *name;
    const char *message; /* what ends the run; NULL where it goes on */
    int first, count;    /* of `assigned`: the states that change */
    bool sampled;        /* the condition counts samples: from 0 on */
} EventInfo;

/* Value reference of the first variable of each role. */
enum {
    FIRST_STATE = 1,
    FIRST_DERIVATIVE = FIRST_STATE + NX,
    FIRST_ALGEBRAIC = FIRST_DERIVATIVE + NX,
    FIRST_INPUT = FIRST_ALGEBRAIC + NZ,
    FIRST_MODE = FIRST_INPUT + NU - N_MODES,
    FIRST_PARAMETER = FIRST_INPUT + NU,
    FIRST_OUTPUT = FIRST_PARAMETER + NP,
    N_VARIABLES = FIRST_OUTPUT + NY
};

/* A model that tells whether it is valid has the margins of its limits as event indicators; then
   come those of its relations, which are its last outputs. */
enum { N_MARGINS = HAS_VALID ? N_LIMITS : 0, N_INDICATORS = N_MARGINS + N_WATCHED };

INSIDE_BEGIN

extern const VariableInfo variables[];
extern const char *const limits[]; /* what is true while the model holds; N_LIMITS of them */
extern const RelationInfo relations[];
extern const EventInfo events[];
extern const int assigned[];
extern const double pulses[];        /* times at which steps end, so that none spans a pulse */
extern const int bounded[];          /* relations of time whose arguments have bounds */
extern const int pulse_parameters[]; /* on which these times depend; -1 ends the list */

INSIDE_END

#endif
