/* A whole run for a page in a browser, compiled to WebAssembly together with the FMU that it runs.

   A row of the result holds the values of the chosen variables at an output time, and behind them
   what the picture needs: the function `drawn(values, time)` of the first of these values. */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "model.h"

#define EXPORTED(name) __attribute__((export_name(#name)))

int drawn(const double **arg, double **res, long long *iw, double *w, int mem);
int drawn_work(long long *arg, long long *res, long long *iw, long long *w);

enum { MOST_TEXT = 100000, MOST_LINE = 4000 };

/* Variables by value reference, and their values. */
typedef struct {
    size_t count;
    const unsigned *references;
    const double *values;
} Settings;

static char messages[MOST_TEXT + MOST_LINE];

/* The messages of the last run, a line each. */
EXPORTED(page_messages) const char *page_messages(void) {
    return messages;
}

EXPORTED(page_room) void *page_room(size_t bytes) {
    return malloc(bytes);
}

/* The runtime hands over complete text, without what `printf` would replace. If there is no room
   for all lines, the first ones stay, and the last one, which may say why the run ends. */
static void keep(void *environment, fmi2String instance, fmi2Status status, fmi2String category,
                 fmi2String text, ...) {
    static size_t last;
    const size_t used = strlen(messages), length = strlen(text);
    const int full = used > MOST_TEXT;
    (void)environment, (void)instance, (void)category;
    if (length + 2 > MOST_LINE || (full && status == fmi2OK)) return;
    if (!full) last = used;
    memcpy(messages + last, text, length);
    memcpy(messages + last + length, "\n", 2);
}

/* The picture behind the values of a row. */
static int draw(double *row, size_t values, double time) {
    static double *w;
    static long long *iw;
    static const double **arg;
    static double **res;
    if (!arg) {
        long long n_arg, n_res, n_iw, n_w;
        drawn_work(&n_arg, &n_res, &n_iw, &n_w);
        arg = malloc((size_t)n_arg * sizeof *arg);
        res = malloc((size_t)n_res * sizeof *res);
        iw = malloc((size_t)(n_iw + 1) * sizeof *iw);
        w = malloc((size_t)(n_w + 1) * sizeof *w);
        if (!arg || !res || !iw || !w) return 1;
    }
    arg[0] = row;
    arg[1] = &time;
    res[0] = row + values;
    return drawn(arg, res, iw, w, 0);
}

static int starts(fmi2Component fmu, const Settings *given, const double *times, size_t n) {
    return fmi2SetupExperiment(fmu, fmi2False, 0, times[0], fmi2True, times[n - 1]) > fmi2Warning ||
           fmi2EnterInitializationMode(fmu) > fmi2Warning ||
           fmi2SetReal(fmu, given->references, given->count, given->values) > fmi2Warning ||
           fmi2ExitInitializationMode(fmu) > fmi2Warning;
}

/* Writes a row for each output time; returns how many of them the run has reached. */
EXPORTED(page_run)
size_t page_run(const Settings *given, size_t values, const unsigned *references, size_t n,
                const double *times, size_t width, double *rows) {
    const fmi2CallbackFunctions host = {keep, calloc, free, NULL, NULL};
    messages[0] = '\0';
    fmi2Component fmu =
        fmi2Instantiate("page", fmi2CoSimulation, MODEL_GUID, "", &host, fmi2False, fmi2True);
    size_t i = 0;
    if (fmu && !starts(fmu, given, times, n))
        for (; i < n; ++i) {
            double *row = rows + i * width;
            if (i > 0 &&
                fmi2DoStep(fmu, times[i - 1], times[i] - times[i - 1], fmi2True) > fmi2Warning)
                break;
            if (fmi2GetReal(fmu, references, values, row) > fmi2Warning ||
                draw(row, values, times[i]))
                break;
        }
    if (fmu) fmi2FreeInstance(fmu);
    return i;
}
