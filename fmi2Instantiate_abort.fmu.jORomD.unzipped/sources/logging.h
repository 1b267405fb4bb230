/* Messages to the importer's logger, by category. */
#ifndef LOGGING_H
#define LOGGING_H

#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

#if defined __GNUC__
#define PRINTF_LIKE __attribute__((format(printf, 3, 4)))
#else
#define PRINTF_LIKE
#endif

PRINTF_LIKE void log_text(const Instance *self, Status status, const char *format, ...);
PRINTF_LIKE Status refuse(Instance *self, Status status, const char *format, ...);
Status choose_categories(Instance *self, bool on, size_t count, const char *const names[]);

INSIDE_END

#endif
