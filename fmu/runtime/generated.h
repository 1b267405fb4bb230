/* What comes before the code that CasADi generates. Others compile without our options, so the code
   itself hides its symbols. */
#ifndef GENERATED_H
#define GENERATED_H

#include "sine.h"
#include "visibility.h"

INSIDE_BEGIN

#define CASADI_SYMBOL_EXPORT
#if defined __GNUC__
#define SMALL __attribute__((cold)) /* compiled for size */
#else
#define SMALL
#endif

#endif
