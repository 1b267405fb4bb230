/* The variables of a model; model.h and the table are generated, one entry per value reference:
   time, states, derivatives, algebraic unknowns, inputs, parameters, outputs. */
#ifndef VARIABLES_H
#define VARIABLES_H

#include <stdbool.h>

#include "model.h"
#include "visibility.h"

/* Length of an array that a model may not need: C knows no array of length 0. */
#define ROOM(n) ((n) > 0 ? (n) : 1)

typedef enum { TIME, STATE, DERIVATIVE, ALGEBRAIC, INPUT, PARAMETER, OUTPUT } Role;

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

/* Value reference of the first variable of each role. */
enum {
    FIRST_STATE = 1,
    FIRST_DERIVATIVE = FIRST_STATE + NX,
    FIRST_ALGEBRAIC = FIRST_DERIVATIVE + NX,
    FIRST_INPUT = FIRST_ALGEBRAIC + NZ,
    FIRST_PARAMETER = FIRST_INPUT + NU,
    FIRST_OUTPUT = FIRST_PARAMETER + NP,
    N_VARIABLES = FIRST_OUTPUT + NY
};

/* A model that tells whether it is valid has the margins of its limits as event indicators. */
enum { N_INDICATORS = HAS_VALID ? N_LIMITS : 0 };

INSIDE_BEGIN

extern const VariableInfo variables[];
extern const char *const limits[]; /* what is true while the model holds; N_LIMITS of them */

INSIDE_END

#endif
