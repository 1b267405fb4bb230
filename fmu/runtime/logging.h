/* Messages to the importer's logger, by category. */
#ifndef LOGGING_H
#define LOGGING_H

#include <stdarg.h>
#include <string.h>
#ifndef FMU_STATIC
#include <stdio.h>
#endif

#include "state.h"

#if defined __GNUC__
#define PRINTF_LIKE __attribute__((format(printf, 3, 4)))
#else
#define PRINTF_LIKE
#endif

enum { TEXT_SIZE = 512 };

/* The category of a status; the model description lists the same names. */
static const char *const categories[] = {"logEvents", "logStatusWarning", "logStatusDiscard",
                                         "logStatusError"};

enum { N_CATEGORIES = sizeof categories / sizeof *categories };

/* Importers read '%' as in printf and '#' as a variable's reference: let neither through. */
static void disarm(char *text) {
    for (; *text; text++)
        if (*text == '%' || *text == '#' || (unsigned char)*text < ' ') *text = '?';
}

/* Leave out the last character of a full text, whose last bytes may be missing. */
static void end_whole(char *text) {
    size_t size = strlen(text);
    if (size < TEXT_SIZE - 1) return;
    while (size > 0 && ((unsigned char)text[size - 1] & 0xC0) == 0x80) size--;
    if (size > 0 && (unsigned char)text[size - 1] >= 0xC0) size--;
    text[size] = '\0';
}

#ifdef FMU_STATIC
/* Without the numbers: formatting takes a library that a controller may not have. */
static void write_message(char *text, const char *function, const char *format, va_list list) {
    (void)list;
    const char *parts[] = {function, ": ", format};
    size_t used = 0;
    for (int i = 0; i < 3; i++)
        for (const char *c = parts[i]; *c && used < TEXT_SIZE - 1; c++) text[used++] = *c;
    text[used] = '\0';
}
#else
static void write_message(char *text, const char *function, const char *format, va_list list) {
    const int used = snprintf(text, TEXT_SIZE, "%s: ", function);
    if (used >= 0 && used < TEXT_SIZE)
        vsnprintf(text + used, TEXT_SIZE - (size_t)used, format, list);
}
#endif

static void log_arguments(const Instance *self, Status status, const char *format, va_list list) {
    if (!self->host.logger || !(self->categories >> status & 1)) return;
    char text[TEXT_SIZE] = "";
    write_message(text, self->function, format, list);
    end_whole(text);
    disarm(text);
    self->host.log(self, status, categories[status], text);
}

/* Log "FUNCTION: MESSAGE" where the category of the status is on. */
static PRINTF_LIKE void log_text(const Instance *self, Status status, const char *format, ...) {
    va_list list;
    va_start(list, format);
    log_arguments(self, status, format, list);
    va_end(list);
}

/* Log why, and return the status. After an error only reset, restore and free are possible:
   FMI 2 has a state for that, FMI 3 terminates. */
static PRINTF_LIKE Status refuse(Instance *self, Status status, const char *format, ...) {
    va_list list;
    va_start(list, format);
    log_arguments(self, status, format, list);
    va_end(list);
    if (status == ERROR) self->state.mode = self->host.fmi_version == 2 ? FAULTY : TERMINATED;
    return status;
}

/* Switch categories: all of them when none is named. FMI 2 leaves exactly the named ones on,
   FMI 3 adds them. */
static Status choose_categories(Instance *self, bool on, size_t count, const char *const names[]) {
    if (count > 0 && !names) return refuse(self, ERROR, "%zu categories, but no list", count);
    uint32_t chosen = count == 0 ? UINT32_MAX : 0;
    for (size_t i = 0; i < count; i++) {
        uint32_t k = 0;
        while (k < N_CATEGORIES && (!names[i] || strcmp(names[i], categories[k]) != 0)) k++;
        if (k == N_CATEGORIES)
            return refuse(self, ERROR, "log category %.80s is unknown; known: %s, %s, %s, %s",
                          names[i] ? names[i] : "NULL", categories[0], categories[1], categories[2],
                          categories[3]);
        chosen |= UINT32_C(1) << k;
    }
    const uint32_t kept = self->host.fmi_version == 2 ? 0 : self->categories;
    self->categories = on ? kept | chosen : self->categories & ~chosen;
    return OK;
}

#endif
