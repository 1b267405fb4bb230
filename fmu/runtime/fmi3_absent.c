/* FMI 3.0: the functions of what these models do not have - variables of other types, clocks,
   structural parameters, model partitions. Without a variable asked, they do nothing. */
#include "fmi3.h"

#define REFERENCES const fmi3ValueReference valueReferences[], size_t nValueReferences

#define NOT_READ_OF(TYPE)                                                                          \
    fmi3Status fmi3Get##TYPE(fmi3Instance instance, REFERENCES, fmi3##TYPE values[],               \
                             size_t nValues) {                                                     \
        (void)valueReferences, (void)values, (void)nValues;                                        \
        return ANSWERED(instance, IN_GET_VALUES, no_variables(instance, nValueReferences));        \
    }
#define NOT_SET_OF(TYPE)                                                                           \
    fmi3Status fmi3Set##TYPE(fmi3Instance instance, REFERENCES, const fmi3##TYPE values[],         \
                             size_t nValues) {                                                     \
        (void)valueReferences, (void)values, (void)nValues;                                        \
        return ANSWERED(instance, IN_SET_DISCRETE, no_variables(instance, nValueReferences));      \
    }
#define NO_VARIABLES_OF(TYPE) NOT_READ_OF(TYPE) NOT_SET_OF(TYPE)

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

fmi3Status fmi3GetBinary(fmi3Instance instance, REFERENCES, size_t valueSizes[],
                         fmi3Binary values[], size_t nValues) {
    (void)valueReferences, (void)valueSizes, (void)values, (void)nValues;
    return ANSWERED(instance, IN_GET_VALUES, no_variables(instance, nValueReferences));
}

fmi3Status fmi3SetBinary(fmi3Instance instance, REFERENCES, const size_t valueSizes[],
                         const fmi3Binary values[], size_t nValues) {
    (void)valueReferences, (void)valueSizes, (void)values, (void)nValues;
    return ANSWERED(instance, IN_SET_DISCRETE, no_variables(instance, nValueReferences));
}

/* -- clocks ----------------------------------------------------------------------------------- */

/* The modes of the standard's lists: clocks tick in events, intervals and shifts are settled
   in initialization mode too. */
enum {
    IN_CLOCKS = EVENT_MODE | INTERFACE_ME,
    IN_INTERVALS = INITIALIZATION_MODE | EVENT_MODE | EITHER,
    IN_SHIFTS = INITIALIZATION_MODE | EITHER
};

fmi3Status fmi3GetClock(fmi3Instance instance, REFERENCES, fmi3Clock values[]) {
    (void)valueReferences, (void)values;
    return ANSWERED(instance, IN_CLOCKS, no_variables(instance, nValueReferences));
}

fmi3Status fmi3SetClock(fmi3Instance instance, REFERENCES, const fmi3Clock values[]) {
    (void)valueReferences, (void)values;
    return ANSWERED(instance, IN_CLOCKS, no_variables(instance, nValueReferences));
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, REFERENCES, fmi3Float64 intervals[],
                                  fmi3IntervalQualifier qualifiers[]) {
    (void)valueReferences, (void)intervals, (void)qualifiers;
    return ANSWERED(instance, IN_INTERVALS, no_variables(instance, nValueReferences));
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, REFERENCES, fmi3UInt64 counters[],
                                   fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[]) {
    (void)valueReferences, (void)counters, (void)resolutions, (void)qualifiers;
    return ANSWERED(instance, IN_INTERVALS, no_variables(instance, nValueReferences));
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, REFERENCES, fmi3Float64 shifts[]) {
    (void)valueReferences, (void)shifts;
    return ANSWERED(instance, IN_SHIFTS, no_variables(instance, nValueReferences));
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, REFERENCES, fmi3UInt64 counters[],
                                fmi3UInt64 resolutions[]) {
    (void)valueReferences, (void)counters, (void)resolutions;
    return ANSWERED(instance, IN_SHIFTS, no_variables(instance, nValueReferences));
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, REFERENCES,
                                  const fmi3Float64 intervals[]) {
    (void)valueReferences, (void)intervals;
    return ANSWERED(instance, IN_INTERVALS, no_variables(instance, nValueReferences));
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, REFERENCES, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[]) {
    (void)valueReferences, (void)counters, (void)resolutions;
    return ANSWERED(instance, IN_INTERVALS, no_variables(instance, nValueReferences));
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance instance, REFERENCES, const fmi3Float64 shifts[]) {
    (void)valueReferences, (void)shifts;
    return ANSWERED(instance, IN_SHIFTS, no_variables(instance, nValueReferences));
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, REFERENCES, const fmi3UInt64 counters[],
                                const fmi3UInt64 resolutions[]) {
    (void)valueReferences, (void)counters, (void)resolutions;
    return ANSWERED(instance, IN_SHIFTS, no_variables(instance, nValueReferences));
}

/* -- capabilities that the model description denies -------------------------------------------- */

static Status denied(Instance *self) {
    return refuse(self, ERROR, "the model does not offer this");
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance,
                                               fmi3ValueReference valueReference,
                                               size_t *nDependencies) {
    (void)valueReference, (void)nDependencies;
    return ANSWERED(instance, ALWAYS, denied(instance));
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[],
                                       fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[],
                                       fmi3DependencyKind dependencyKinds[], size_t nDependencies) {
    (void)dependent, (void)elementIndicesOfDependent, (void)independents;
    (void)elementIndicesOfIndependents, (void)dependencyKinds, (void)nDependencies;
    return ANSWERED(instance, ALWAYS, denied(instance));
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance) {
    return ANSWERED(instance, ALWAYS, denied(instance));
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance) {
    return ANSWERED(instance, ALWAYS, denied(instance));
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clockReference,
                                      fmi3Float64 activationTime) {
    (void)clockReference, (void)activationTime;
    return ANSWERED(instance, ALWAYS, denied(instance));
}
