/* Generated. */
#include "variables.h"
#include <float.h>
#include <stddef.h>

const VariableInfo variables[] = {
    {"time", TIME, CALCULATED, 0.0, 1.0, -DBL_MAX, DBL_MAX, 0.0, false},
    {"x", STATE, EXACT, 1.0, 1.0, -DBL_MAX, DBL_MAX, 1.0, false},
    {"der(x)", DERIVATIVE, CALCULATED, 0.0, 1.0, -DBL_MAX, DBL_MAX, 0.0, false},
    {"force", INPUT, EXACT, 0.0, 1.0, -DBL_MAX, DBL_MAX, 0.0, false},
    {"rate", PARAMETER, EXACT, 0.5, 0.5, 0.0, 100.0, 0.5, true},
    {"y", OUTPUT, CALCULATED, 0.0, 1.0, -DBL_MAX, DBL_MAX, 0.0, false},
};

const char *const limits[] = {
    NULL,
};
