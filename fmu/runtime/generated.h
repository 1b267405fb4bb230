/* What comes before the code that CasADi generates, which is the end of the one unit fmu.c. */
#ifndef GENERATED_H
#define GENERATED_H

#include "sine.h"

#define CASADI_SYMBOL_EXPORT static
#if defined __GNUC__
#define SMALL __attribute__((cold)) /* compiled for size */
#if !defined _WIN32
#pragma GCC visibility push(hidden) /* of CasADi's helpers, whatever the options of compilers */
#endif
#else
#define SMALL
#endif

#endif
