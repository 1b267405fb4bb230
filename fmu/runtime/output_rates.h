/* Time derivatives of outputs along the solution, up to order 3. */
#ifndef OUTPUT_RATES_H
#define OUTPUT_RATES_H

#include "state.h"

static Status get_rates(Instance *self, const uint32_t references[], size_t count,
                        const int32_t orders[], double values[]);

#endif
