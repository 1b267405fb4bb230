/* Co-simulation over a grid: the communication points and step sizes of FMPy, bit for bit. */
#ifndef CO_SIMULATION_H
#define CO_SIMULATION_H

#include "interrupt.h"
#include "part.h"
#include "run.h"

/* Takes one step of a length to `next`; `time` is where the FMU is afterwards. Returns how the run
 * goes on: DONE where it does. */
static inline int communicate(Fmu *fmu, Part *part, double *time, double length, double next) {
    const int how = part_step(fmu, part, *time, length);
    if (how == PART_FAILED || how == NOT_STEPPED) return CALL_FAILED;
    if (how != PART_ENDED && part->reached < *time + length) return EARLY_RETURN;
    *time = how == PART_ENDED ? part->reached : next;
    return how == PART_ENDED ? ENDED_BY_FMU : DONE;
}

static inline int co_simulation(Run *run, Fmu *fmu) {
    double time = run->start;
    Part part = {.call = run->functions};
    if (record(fmu, run->recording, 0)) return CALL_FAILED;
    run->rows = 1;
    for (long long n = 0; run->rows < run->points;) {
        if (time > run->stop || near(run, time, run->stop)) return DONE;
        if (halted) return INTERRUPTED;
        const double regular = run->start + (double)(n + 1) * run->interval;
        double next = regular;
        if (next > run->stop && !near(run, next, run->stop)) {
            if (!run->any_step) return DONE;
            next = run->stop;
        }
        const double before = time;
        const int how = communicate(fmu, &part, &time, next - time, next);
        run->time = time;
        if (how == CALL_FAILED || how == EARLY_RETURN) return how;
        if (how == ENDED_BY_FMU && time <= before) return how; /* its row is there */
        ++run->steps;
        if (record(fmu, run->recording, run->rows)) return CALL_FAILED;
        ++run->rows;
        if (how != DONE) return how;
        if (near(run, time, regular)) ++n;
    }
    return DONE;
}

SHARED void run_fmu(Run *run) {
    answer(run, co_simulation);
}

#endif
