/* FMI 3.0: the functions of what these models do not have - variables of other types, clocks,
   structural parameters, model partitions. Without a variable asked, they do nothing. */
#include "fmi3.h"

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"

/* A function of variables that no model has, and the modes in which it is allowed. */
#define ABSENT(NAME, MODES, ...)                                                                   \
    fmi3Status NAME(fmi3Instance instance, const fmi3ValueReference valueReferences[],             \
                    size_t nValueReferences, __VA_ARGS__) {                                        \
        return ANSWERED(instance, MODES, no_variables(instance, nValueReferences));                \
    }

#define NOT_SET_OF(TYPE)                                                                           \
    ABSENT(fmi3Set##TYPE, IN_SET_DISCRETE, const fmi3##TYPE values[], size_t nValues)
#define NO_VARIABLES_OF(TYPE)                                                                      \
    ABSENT(fmi3Get##TYPE, IN_GET_VALUES, fmi3##TYPE values[], size_t nValues)                      \
    NOT_SET_OF(TYPE)

NO_VARIABLES_OF(Float32)
NO_VARIABLES_OF(Int8)
NO_VARIABLES_OF(UInt8)
NO_VARIABLES_OF(Int16)
NO_VARIABLES_OF(UInt16)
NO_VARIABLES_OF(Int32)
NO_VARIABLES_OF(UInt32)
NO_VARIABLES_OF(Int64)
NO_VARIABLES_OF(UInt64)
NO_VARIABLES_OF(String)
NOT_SET_OF(Boolean) /* `valid` is read in fmi3.c */
ABSENT(fmi3GetBinary, IN_GET_VALUES, size_t valueSizes[], fmi3Binary values[], size_t nValues)
ABSENT(fmi3SetBinary, IN_SET_DISCRETE, const size_t valueSizes[], const fmi3Binary values[],
       size_t nValues)

/* -- clocks ----------------------------------------------------------------------------------- */

/* The modes of the standard's lists: clocks tick in events, intervals and shifts are settled
   in initialization mode too. */
enum {
    IN_CLOCKS = EVENT_MODE | INTERFACE_ME,
    IN_INTERVALS = INITIALIZATION_MODE | EVENT_MODE | EITHER,
    IN_SHIFTS = INITIALIZATION_MODE | EITHER
};

ABSENT(fmi3GetClock, IN_CLOCKS, fmi3Clock values[])
ABSENT(fmi3SetClock, IN_CLOCKS, const fmi3Clock values[])
ABSENT(fmi3GetIntervalDecimal, IN_INTERVALS, fmi3Float64 intervals[],
       fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetIntervalFraction, IN_INTERVALS, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
       fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetShiftDecimal, IN_SHIFTS, fmi3Float64 shifts[])
ABSENT(fmi3GetShiftFraction, IN_SHIFTS, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
ABSENT(fmi3SetIntervalDecimal, IN_INTERVALS, const fmi3Float64 intervals[])
ABSENT(fmi3SetIntervalFraction, IN_INTERVALS, const fmi3UInt64 counters[],
       const fmi3UInt64 resolutions[])
ABSENT(fmi3SetShiftDecimal, IN_SHIFTS, const fmi3Float64 shifts[])
ABSENT(fmi3SetShiftFraction, IN_SHIFTS, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

/* -- capabilities that the model description denies -------------------------------------------- */

#define DENIED(NAME, ...)                                                                          \
    fmi3Status NAME(__VA_ARGS__) {                                                                 \
        return ANSWERED(instance, ALWAYS,                                                          \
                        refuse(instance, ERROR, "the model does not offer this"));                 \
    }

DENIED(fmi3GetNumberOfVariableDependencies, fmi3Instance instance,
       fmi3ValueReference valueReference, size_t *nDependencies)
DENIED(fmi3GetVariableDependencies, fmi3Instance instance, fmi3ValueReference dependent,
       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
       size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
       size_t nDependencies)
DENIED(fmi3EnterConfigurationMode, fmi3Instance instance)
DENIED(fmi3ExitConfigurationMode, fmi3Instance instance)
DENIED(fmi3ActivateModelPartition, fmi3Instance instance, fmi3ValueReference clockReference,
       fmi3Float64 activationTime)

#pragma GCC diagnostic pop
