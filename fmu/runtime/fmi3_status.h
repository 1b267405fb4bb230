/* FMI 3.0's status of a call, from the runtime's. */
#ifndef FMI3_STATUS_H
#define FMI3_STATUS_H

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

/* All variables are scalars: FMI 3 counts their values besides. */
static inline bool one_each(Instance *self, size_t values, size_t variables_asked) {
    if (values == variables_asked) return true;
    refuse(self, ERROR, "%zu values for %zu scalar variables", values, variables_asked);
    return false;
}

#endif
