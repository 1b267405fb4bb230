/* The solver of co-simulation; one of the files integration_*.c is compiled. */
#ifndef INTEGRATION_H
#define INTEGRATION_H

#include "instance.h"

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility push(hidden)
#endif

/* Integrate up to `end`, or as far as it goes; time tells how far. Inputs move with their slopes. */
bool integrate_to(Instance *self, double end);

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility pop
#endif

#endif
