/* FMI 2.0's status of a call, from the runtime's. */
#ifndef FMI2_STATUS_H
#define FMI2_STATUS_H

#include "fmi2Functions.h"
#include "instance.h"
#include "logging.h"

_Static_assert((int)OK == (int)fmi2OK && (int)WARNING == (int)fmi2Warning &&
                   (int)DISCARD == (int)fmi2Discard && (int)ERROR == (int)fmi2Error,
               "the numbers are the same");

static inline fmi2Status fmi2_status(Status status) {
    return (fmi2Status)status;
}

#endif
