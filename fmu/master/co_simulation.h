/* Co-simulation over a grid: the communication points and step sizes of FMPy, bit for bit. */
#ifndef CO_SIMULATION_H
#define CO_SIMULATION_H

#include "interrupt.h"
#include "run.h"

/* Takes one step of a length to `next`; `time` is where the FMU is afterwards. Returns how the run
 * goes on: DONE where it does. */
static inline int communicate(Fmu *fmu, double *time, double length, double next) {
    const Functions *call = fmu->call;
    if (call->version == 2) {
        const int status = call->do_step_2(call->instance, *time, length, 1);
        if (!failed(fmu, "do_step_2", status)) {
            *time = next;
            return DONE;
        }
        int terminated = 0;
        if (status == DISCARD) call->get_boolean_status(call->instance, TERMINATED, &terminated);
        if (!terminated ||
            failed(fmu, "get_real_status",
                   call->get_real_status(call->instance, LAST_SUCCESSFUL_TIME, time)))
            return CALL_FAILED;
        return ENDED_BY_FMU;
    }
    bool event = false, terminate = false, early = false;
    double last = next;
    const int status =
        call->do_step_3(call->instance, *time, length, true, &event, &terminate, &early, &last);
    if (failed(fmu, "do_step_3", status)) return CALL_FAILED;
    if (early && !terminate) return EARLY_RETURN;
    *time = terminate ? last : next;
    return terminate ? ENDED_BY_FMU : DONE;
}

static inline int co_simulation(Run *run, Fmu *fmu) {
    double time = run->start;
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
        const int how = communicate(fmu, &time, next - time, next);
        run->time = time;
        if (how == CALL_FAILED || how == EARLY_RETURN || how == STUCK) return how;
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
