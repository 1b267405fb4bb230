/* Only the FMI functions leave the library: what stands between the two is for its inside, under
   names of its own. */
#ifndef VISIBILITY_H
#define VISIBILITY_H

#include "internal_names.h"

#if defined __GNUC__ && !defined _WIN32
#define INSIDE_BEGIN _Pragma("GCC visibility push(hidden)")
#define INSIDE_END _Pragma("GCC visibility pop")
#else
#define INSIDE_BEGIN
#define INSIDE_END
#endif

#endif
