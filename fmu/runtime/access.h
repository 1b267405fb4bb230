/* Variables by value reference: which may be read, which may be set when and to what. */
#ifndef ACCESS_H
#define ACCESS_H

#include "state.h"

static Status get_values(Instance *self, const uint32_t references[], size_t count,
                         double values[]);
static Status set_values(Instance *self, const uint32_t references[], size_t count,
                         const double values[]);
static Status get_block(Instance *self, size_t first, double values[], size_t count);
static Status get_validity(Instance *self, const uint32_t references[], size_t count, bool *valid);
static Status get_indicators(Instance *self, double values[], size_t count);
static Status get_nominals(Instance *self, double nominals[], size_t count);
static Status set_states(Instance *self, const double x[], size_t count);
static Status set_time(Instance *self, double time);
static bool all_known(Instance *self, const uint32_t references[], size_t count);

#endif
