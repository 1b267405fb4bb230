/* Life of an instance: creation, reset, what is allowed when. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "state.h"

static Instance *create(const Host *host, const char *function, const char *name, const char *token,
                        unsigned interface, bool logging);
static void destroy(Instance *self);
static void reset(Instance *self);
static bool allowed(Instance *self, unsigned modes, const char *function);

#endif
