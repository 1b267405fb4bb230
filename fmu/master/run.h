/* One call for a whole run: what it is given, and what it tells afterwards. */
#ifndef RUN_H
#define RUN_H

#include <float.h>

#include "recording.h"

/* How a run ended. */
enum {
    DONE,
    CALL_FAILED,
    ENDED_BY_FMU,
    STUCK,
    EARLY_RETURN,
    STEP_VANISHED,
    INTERRUPTED,
    NOT_A_NUMBER
};

typedef struct {
    const Functions *functions;
    const Recording *recording;
    const double *times; /* of outputs */
    long long points;
    double start, stop, interval; /* as they were asked for */
    long long any_step;           /* co-simulation: whether steps may differ */
    long long states, indicators; /* model exchange */
    long long needs_completed_step, next_defined;
    double next_event, relative_tolerance;
    const double *nominals;
    void (*note)(double t, const double *states, bool event); /* after a step, before an event */
    /* answers */
    long long how, rows, steps, calls, events, status;
    const char *function;
    double time;
} Run;

/* Runs an FMU; its answers tell how that went. */
static inline void answer(Run *run, int (*interface)(Run *, Fmu *)) {
    Fmu fmu = {.call = run->functions};
    run->time = run->start;
    run->how = interface(run, &fmu);
    run->function = fmu.function;
    run->status = fmu.status;
}

/* Whether two times are the same but for rounding, at a relative distance; they count from the
 * start of the run. At 0 as Python's math.isclose. */
static inline int at_one_time(double a, double b, double start, double relative) {
    const double rounding = 4 * DBL_EPSILON * fmax(fabs(a), fabs(b));
    const double since = fmax(fabs(a - start), fabs(b - start));
    return a == b ||
           fabs(a - b) < fmin(fmax(rounding, relative * since), INFINITY); /* not if never */
}

/* The distance below which rounding makes times of a coupled system one. FMUs tell the time of an
 * event to 8 roundings. */
static inline double rounding_of_times(double span, double t) {
    return DBL_EPSILON * fmax(4 * span, 16 * fabs(t));
}

/* Events are located two roundings too late, which may add up. */
static inline int near(const Run *run, double a, double b) {
    const double late = 2 * DBL_EPSILON * (double)run->events * fmax(fabs(a), fabs(b));
    return fabs(a - b) < late || at_one_time(a, b, run->start, 1e-9);
}

#endif
