/* FMI 2.0's status of a call, from the runtime's. */
#ifndef FMI2_STATUS_H
#define FMI2_STATUS_H

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

#endif
