/* Life of an instance: creation, reset, what is allowed when. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

Instance *create(const Host *host, const char *function, const char *name, const char *token,
                 unsigned interface, bool logging);
void destroy(Instance *self);
void reset(Instance *self);
bool allowed(Instance *self, unsigned modes, const char *function);

INSIDE_END

#endif
