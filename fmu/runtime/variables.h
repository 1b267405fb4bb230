/* The variables of a model; model.h and the table are generated, one entry per value reference:
   time, states, derivatives, algebraic unknowns, inputs and modes, parameters, outputs. */
#ifndef VARIABLES_H
#define VARIABLES_H

#include <stdbool.h>

#include "model.h"

/* Length of an array that a model may not need: C knows no array of length 0. */
#define ROOM(n) ((n) > 0 ? (n) : 1)

#if defined MODES
#define HAS_EVENTS 1
#else /* the sizes of solvers/hybrid/laws.h, and how many relations are not of time alone */
#define HAS_EVENTS 0
#define MODES 0
#define EVENTS 0
#define ASSIGNED 0
#define DEFECTS 0
#define BOUNDED 0
#define ENCLOSED 0
#define N_WATCHED 0
#endif
#if !defined N_PULSES
#define N_PULSES 0
#endif
#if !defined BOUNDED_LIMITS
#define BOUNDED_LIMITS 0 /* whose margins have bounds */
#define LIMITS_OF_TIME 0 /* whether these depend on time */
#define LAWS_OF_TIME 0   /* whether the equations do */
#endif
#if !defined FIXED_STEPS
#define FIXED_STEPS 0 /* stages of a solver whose steps have a fixed size */
#define ORDER_OF_STEPS 0
#endif
#define HAS_LOOKS (N_WATCHED > 0 || BOUNDED_LIMITS > 0) /* of importers of model exchange */
#define HAS_LEAPS (N_WATCHED > 0 && NU > MODES)         /* of inputs that relations may depend on */
#if HAS_EVENTS
#include "laws.h"
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
    double guess;       /* of a calculated state: where its solution begins */
    bool tunable;       /* a parameter that may change during a run */
    bool rests_at_zero; /* a state whose derivative is 0 where it is 0 */
} VariableInfo;

/* Value reference of the first variable of each role. */
enum {
    FIRST_STATE = 1,
    FIRST_DERIVATIVE = FIRST_STATE + NX,
    FIRST_ALGEBRAIC = FIRST_DERIVATIVE + NX,
    FIRST_INPUT = FIRST_ALGEBRAIC + NZ,
    FIRST_MODE = FIRST_INPUT + NU - MODES,
    FIRST_PARAMETER = FIRST_INPUT + NU,
    FIRST_OUTPUT = FIRST_PARAMETER + NP,
    N_VARIABLES = FIRST_OUTPUT + NY
};

/* The event indicators, which are the last outputs: the margins of the limits, and those of the
   relations. */
enum { N_INDICATORS = N_LIMITS + N_WATCHED };

/* variables, limits (what is true while the model holds) and violations (what is wrong where it
   does not), warnings (what may follow from parameters), and with HAS_EVENTS the tables of
   solvers/hybrid/laws.h, MODEL_LAWS (these and the model's functions, as solvers/model_laws.h has
   them), the names of relations and rules, rule_messages (what ends the run; empty where it goes
   on) and pulses (times at which steps end, so that none spans a pulse) */
#include "tables.h"

#endif
