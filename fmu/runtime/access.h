/* Variables by value reference: which may be read, which may be set when and to what. */
#ifndef ACCESS_H
#define ACCESS_H

#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

Status get_values(Instance *self, const uint32_t references[], size_t count, double values[]);
Status set_values(Instance *self, const uint32_t references[], size_t count, const double values[]);
Status get_block(Instance *self, size_t first, double values[], size_t count);
Status get_validity(Instance *self, const uint32_t references[], size_t count, bool *valid);
Status get_indicators(Instance *self, double values[], size_t count);
Status get_nominals(Instance *self, double nominals[], size_t count);
Status set_states(Instance *self, const double x[], size_t count);
Status set_time(Instance *self, double time);
bool known(Instance *self, const uint32_t references[], size_t count);

INSIDE_END

#endif
