/* FMI 2.0 for its functions: the status of a call, and in which states each function is allowed. */
#ifndef FMI2_H
#define FMI2_H

#include "fmi2Functions.h"
#include "instance.h"
#include "logging.h"

/* In a program that links several FMUs, whoever builds it defines FMI2_FUNCTION_PREFIX for each;
   some copies of fmi2Functions.h leave it out. FMI 2.0 cannot take a prefix back for shared
   libraries, so that the default is none. */
#ifdef FMI2_FUNCTION_PREFIX
#undef fmi2FullName
#define PASTED(prefix, name) prefix##name
#define NAMED(prefix, name) PASTED(prefix, name)
#define fmi2FullName(name) NAMED(FMI2_FUNCTION_PREFIX, name)
#endif

_Static_assert((int)OK == (int)fmi2OK && (int)WARNING == (int)fmi2Warning &&
                   (int)DISCARD == (int)fmi2Discard && (int)ERROR == (int)fmi2Error,
               "the numbers are the same");

static inline fmi2Status fmi2_status(Status status) {
    return (fmi2Status)status;
}

/* What a function of the FMI returns: an error where it is not allowed, or else an answer. */
#define ANSWERED(instance, modes, answer)                                                          \
    (allowed(instance, modes, __func__) ? fmi2_status(answer) : fmi2Error)

/* In which states of the FMI 2.0.4 state machines each function is allowed: the tables of 3.2.3
   (model exchange) and 4.2.4 (co-simulation). */
enum {
    /* rows of the table that hold for several functions */
    ALWAYS = INSTANTIATED | INITIALIZATION_MODE | EVENT_MODE | CONTINUOUS_TIME_MODE | STEP_MODE |
        STEP_FAILED | TERMINATED | FAULTY | EITHER,
    READING = ALWAYS & ~INSTANTIATED,
    READING_ME = READING & ~INTERFACE_CS,
    STEPPED = STEP_MODE | STEP_FAILED | TERMINATED | INTERFACE_CS,

    IN_SET_DEBUG_LOGGING = ALWAYS,
    IN_RESET = ALWAYS,
    IN_FMU_STATE = ALWAYS, /* get, set, free, serialize and de-serialize it */
    IN_SETUP_EXPERIMENT = INSTANTIATED | EITHER,
    IN_ENTER_INITIALIZATION_MODE = INSTANTIATED | EITHER,
    IN_EXIT_INITIALIZATION_MODE = INITIALIZATION_MODE | EITHER,
    IN_TERMINATE = EVENT_MODE | CONTINUOUS_TIME_MODE | STEP_MODE | STEP_FAILED | EITHER,
    IN_GET_VALUES = READING,
    IN_SET_DISCRETE = INSTANTIATED | INITIALIZATION_MODE | EVENT_MODE | STEP_MODE | EITHER,
    IN_SET_REAL = IN_SET_DISCRETE | CONTINUOUS_TIME_MODE,
    IN_GET_DIRECTIONAL_DERIVATIVE = READING,

    IN_ENTER_EVENT_MODE = EVENT_MODE | CONTINUOUS_TIME_MODE | INTERFACE_ME,
    IN_NEW_DISCRETE_STATES = EVENT_MODE | INTERFACE_ME,
    IN_ENTER_CONTINUOUS_TIME_MODE = EVENT_MODE | INTERFACE_ME,
    IN_COMPLETED_INTEGRATOR_STEP = CONTINUOUS_TIME_MODE | INTERFACE_ME,
    IN_SET_TIME = CONTINUOUS_TIME_MODE | INTERFACE_ME,
    IN_SET_CONTINUOUS_STATES = CONTINUOUS_TIME_MODE | INTERFACE_ME,
    IN_GET_EVENT_INDICATORS = READING_ME,
    IN_GET_CONTINUOUS_STATES = READING_ME,
    IN_GET_DERIVATIVES = READING_ME,
    IN_GET_NOMINALS = READING_ME | INSTANTIATED,

    IN_SET_INPUT_DERIVATIVES = INSTANTIATED | INITIALIZATION_MODE | STEP_MODE | INTERFACE_CS,
    IN_GET_OUTPUT_DERIVATIVES = STEPPED | FAULTY,
    IN_DO_STEP = STEP_MODE | INTERFACE_CS,
    IN_CANCEL_STEP = INTERFACE_CS, /* while a step is pending, which no step here ever is */
    IN_GET_STATUS = STEPPED
};

#endif
