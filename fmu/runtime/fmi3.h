/* FMI 3.0 for its functions: the status of a call, and in which states each function is allowed. */
#ifndef FMI3_H
#define FMI3_H

#include "model.h"

/* In a program that links several FMUs each function has the model's name before it; a shared
   library is compiled with FMI3_OVERRIDE_FUNCTION_PREFIX. */
#ifndef FMI3_FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX MODEL_PREFIX
#endif

#include "fmi3Functions.h"
#include "instance.h"
#include "logging.h"

_Static_assert((int)OK == (int)fmi3OK && (int)WARNING == (int)fmi3Warning &&
                   (int)DISCARD == (int)fmi3Discard && (int)ERROR == (int)fmi3Error,
               "the numbers are the same");

static inline fmi3Status fmi3_status(Status status) {
    return (fmi3Status)status;
}

/* What a function of the FMI returns: an error where it is not allowed, or else an answer. */
#define ANSWERED(instance, modes, answer)                                                          \
    (allowed(instance, modes, __func__) ? fmi3_status(answer) : fmi3Error)

/* All variables are scalars: FMI 3 counts their values besides. */
static inline bool one_each(Instance *self, size_t values, size_t variables_asked) {
    if (values == variables_asked) return true;
    refuse(self, ERROR, "%zu values for %zu scalar variables", values, variables_asked);
    return false;
}

/* In which states of the FMI 3.0.2 state machines each function is allowed: the lists of allowed
   function calls in 2.3 (common states), 3.2 (continuous-time mode) and 4.2 (step mode). */
enum {
    /* lists that hold for several functions */
    INITIALIZED = EVENT_MODE | CONTINUOUS_TIME_MODE | STEP_MODE,
    COMPUTED = INITIALIZATION_MODE | INITIALIZED | TERMINATED,
    ALWAYS = INSTANTIATED | COMPUTED | EITHER,

    IN_SET_DEBUG_LOGGING = ALWAYS | INTERMEDIATE_UPDATE,
    IN_RESET = ALWAYS,
    IN_FMU_STATE = ALWAYS, /* get, set, free, serialize and deserialize it */
    IN_ENTER_INITIALIZATION_MODE = INSTANTIATED | EITHER,
    IN_EXIT_INITIALIZATION_MODE = INITIALIZATION_MODE | EITHER,
    IN_TERMINATE = INITIALIZED | EITHER,
    IN_GET_VALUES = ALWAYS | INTERMEDIATE_UPDATE,
    IN_SET_DISCRETE = INSTANTIATED | INITIALIZATION_MODE | EVENT_MODE | STEP_MODE | EITHER,
    IN_SET_FLOAT = IN_SET_DISCRETE | CONTINUOUS_TIME_MODE | INTERMEDIATE_INPUTS,
    IN_GET_DERIVATIVE = COMPUTED | INTERMEDIATE_UPDATE | EITHER,

    IN_ENTER_EVENT_MODE = CONTINUOUS_TIME_MODE | STEP_MODE | EITHER, /* if it is used at all */
    IN_DISCRETE_STATES = EVENT_MODE | EITHER,
    IN_ENTER_STEP_MODE = EVENT_MODE | INTERFACE_CS,
    IN_ENTER_CONTINUOUS_TIME_MODE = EVENT_MODE | INTERFACE_ME,
    IN_COMPLETED_INTEGRATOR_STEP = CONTINUOUS_TIME_MODE | INTERFACE_ME,
    IN_SET_TIME = CONTINUOUS_TIME_MODE | INTERFACE_ME,
    IN_SET_CONTINUOUS_STATES = CONTINUOUS_TIME_MODE | INTERFACE_ME,
    IN_GET_CONTINUOUS = COMPUTED | INTERFACE_ME, /* states, derivatives, nominals, indicators */
    IN_GET_COUNTS = INSTANTIATED | COMPUTED | INTERFACE_ME,

    IN_GET_OUTPUT_DERIVATIVES = STEP_MODE | INTERMEDIATE_UPDATE | TERMINATED | INTERFACE_CS,
    IN_DO_STEP = STEP_MODE | INTERFACE_CS,

    NEVER = EITHER
};

#endif
