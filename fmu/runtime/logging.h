/* Messages to the importer's logger, by category. */
#ifndef LOGGING_H
#define LOGGING_H

#include "state.h"

#if defined __GNUC__
#define PRINTF_LIKE __attribute__((format(printf, 3, 4)))
#else
#define PRINTF_LIKE
#endif

static PRINTF_LIKE void log_text(const Instance *self, Status status, const char *format, ...);
static PRINTF_LIKE Status refuse(Instance *self, Status status, const char *format, ...);
static Status choose_categories(Instance *self, bool on, size_t count, const char *const names[]);

#endif
