/* Model exchange over a grid: the pair of dop853.h, with the events that the FMI knows.
 *
 * A step ends at a time event; an event of the states is located on the interpolant of its step;
 * after each event the pair begins anew. Output times within a step are interpolated.
 */
#ifndef MODEL_EXCHANGE_H
#define MODEL_EXCHANGE_H

#include <float.h>

#include "dop853.h"
#include "interrupt.h"
#include "run.h"

enum { MOST_TRIED = 100000, MOST_STANDSTILLS = 1000 }; /* per output interval; events at a time */

#if !defined NX || !defined NZ /* room for states and event indicators */
#error "define NX and NZ before solvers are included"
#endif

/* The callback of FMI 3 by which an FMU asks for its inputs within a step. */
typedef void Answer(void *environment, double time, bool asks, bool readable, bool finished,
                    bool may_return, bool *stops, double *until);

typedef struct {
    Run *run;
    Fmu *fmu;
    Ode ode;
    Events events;
    double t, x[NX], h;
    double signs[NZ]; /* indicators at t */
    Slopes k;
    Interpolant piece;
    Answer *inputs; /* sets those of a time; NULL if they do not move */
} Exchange;

/* Brings the FMU to a time and a state. Returns 0 unless a call fails. */
static inline int move_fmu(Exchange *self, double t, const double *x) {
    const Functions *call = self->fmu->call;
    const size_t n = (size_t)self->run->states;
    bool stops = false;
    if (self->inputs) self->inputs(NULL, t, true, false, false, false, &stops, NULL);
    return failed(self->fmu, "set_time", call->set_time(call->instance, t)) ||
           (n && failed(self->fmu, "set_states", call->set_states(call->instance, x, n)));
}

/* dx/dt; where the FMU discards it, it has no value there and a shorter step is taken. */
static inline int exchange_slope(void *context, double t, const double *x, double *dx) {
    Exchange *self = context;
    const Functions *call = self->fmu->call;
    if (!self->run->states) {
        dx[0] = 0;
        return 0;
    }
    if (move_fmu(self, t, x)) return 1;
    ++self->run->calls;
    return failed(self->fmu, "get_derivatives",
                  call->get_derivatives(call->instance, dx, (size_t)self->run->states));
}

static inline double exchange_scale(const void *context, int i, double x) {
    const Run *run = ((const Exchange *)context)->run;
    return run->relative_tolerance * (run->nominals[i] + fabs(x));
}

/* Whether the last failure is more than a discarded evaluation. */
static inline int is_final(const Exchange *self) {
    return self->fmu->function && self->fmu->status != DISCARD;
}

static inline void forget_discards(Exchange *self) {
    if (!is_final(self)) self->fmu->function = NULL;
}

static inline int indicators_at(Exchange *self, double t, const double *x, double *z) {
    const Functions *call = self->fmu->call;
    if (!self->run->indicators) return 0;
    if (move_fmu(self, t, x)) return 1;
    return failed(self->fmu, "get_indicators",
                  call->get_indicators(call->instance, z, (size_t)self->run->indicators));
}

static inline int crossed(const Exchange *self, const double *z) {
    for (long long i = 0; i < self->run->indicators; ++i)
        if ((self->signs[i] > 0) != (z[i] > 0)) return 1;
    return 0;
}

/* Shortens a step to just behind the first crossing on its interpolant; `end` is the state there.
 * Returns 0 unless a call fails. */
static inline int locate(Exchange *self, double *after, double *end) {
    double low = self->t, high = *after, z[NZ], x[NX];
    const double width = 2 * DBL_EPSILON * fabs(high);
    while (high - low > width) {
        const double middle = low + (high - low) / 2;
        if (middle <= low || middle >= high) break;
        evaluate(&self->piece, middle, x);
        if (indicators_at(self, middle, x, z)) return 1;
        if (crossed(self, z))
            high = middle;
        else
            low = middle;
    }
    if (high < *after) evaluate(&self->piece, high, end);
    *after = high;
    return 0;
}

/* Whether a step to a place on the interpolant ends at the state there. It does not where the
 * stages of the interpolant, which no error estimate sees, meet a change that the step passes over.
 */
static inline int confirmed(Exchange *self, double after, const double *end) {
    double own[NX] = {0}, error;
    if (fresh_step(&self->ode, self->t, after, self->x, self->k, own, &error)) return 0;
    for (int i = 0; i < NX; ++i) own[i] -= end[i];
    return norm(&self->ode, own, end) <= 1;
}

/* Records the output times up to the end of a step. */
static inline int record_until(Exchange *self, double after, const double *end) {
    Run *run = self->run;
    double x[NX];
    for (; run->rows < run->points && run->times[run->rows] <= after; ++run->rows) {
        const double time = run->times[run->rows];
        if (time < after) evaluate(&self->piece, time, x);
        if (move_fmu(self, time, time < after ? x : end)) return 1;
        if (record(self->fmu, run->recording, run->rows)) return 1;
    }
    return 0;
}

static inline void note(const Exchange *self, bool event) {
    if (self->run->note) self->run->note(self->t, self->x, event);
}

/* One step towards `goal`, accepted or not. `event` tells whether one follows. Returns how the run
 * goes on. */
static inline int advance(Exchange *self, double goal, int *rejected, bool *event) {
    Run *run = self->run;
    double end[NX], z[NZ], after;
    const bool reaches = step_end(self->t, self->h, goal) == goal; /* however near the goal is */
    if (!reaches && 0.1 * self->h <= fabs(self->t) * DBL_EPSILON) {
        if (self->fmu->function) return CALL_FAILED; /* what was discarded all the way */
        return STEP_VANISHED;
    }
    const double error =
        try_step(&self->ode, self->t, self->h, goal, self->x, self->k, &after, end);
    self->h = after - self->t;
    if (is_final(self)) return CALL_FAILED;
    if (!(error <= 1) || slope(&self->ode, after, end, self->k[END]) || !is_finite(self->k[END])) {
        if (is_final(self)) return CALL_FAILED;
        self->h = smaller_size(self->h, error, *rejected);
        *rejected = 1;
        return DONE;
    }
    forget_discards(self);
    ++run->steps;
    if (indicators_at(self, after, end, z)) return CALL_FAILED;
    const int state_event = crossed(self, z);
    const int within = run->rows < run->points && run->times[run->rows] < after;
    if ((state_event || within) &&
        interpolate(&self->ode, self->t, self->h, self->x, end, self->k, &self->piece))
        return CALL_FAILED;
    if (state_event) {
        const double whole = after;
        if (locate(self, &after, end)) return CALL_FAILED;
        if (after < whole && !confirmed(self, after, end)) {
            if (is_final(self)) return CALL_FAILED;
            --run->steps;
            self->h = after - self->t;
            *rejected = 1;
            return DONE;
        }
    }
    if (record_until(self, after, end) || move_fmu(self, after, end)) return CALL_FAILED;
    bool step_event = false, terminate = false;
    if (run->needs_completed_step && completed_step(self->fmu, &step_event, &terminate))
        return CALL_FAILED;
    memcpy(self->x, end, sizeof end);
    memcpy(self->k[0], self->k[END], sizeof self->k[0]);
    memcpy(self->signs, z, sizeof z);
    run->time = self->t = after;
    note(self, false);
    self->h = fmin(self->h * growth(error, *rejected), (run->stop - run->start) / 50);
    *rejected = 0;
    *event = state_event || step_event;
    return terminate ? ENDED_BY_FMU : DONE;
}

/* Event mode at the present time, and back; rows of this very time are written anew. */
static inline int handle_event(Exchange *self) {
    Run *run = self->run;
    const Functions *call = self->fmu->call;
    ++run->events;
    note(self, true);
    if (failed(self->fmu, "enter_event_mode", call->enter_event_mode(call->instance)) ||
        update(self->fmu, &self->events))
        return CALL_FAILED;
    if (self->events.terminate) return ENDED_BY_FMU;
    if (failed(self->fmu, "enter_continuous_time_mode",
               call->enter_continuous_time_mode(call->instance)))
        return CALL_FAILED;
    if (run->states && failed(self->fmu, "get_states",
                              call->get_states(call->instance, self->x, (size_t)run->states)))
        return CALL_FAILED;
    note(self, false);
    if (run->rows > 0 && near(run, run->times[run->rows - 1], self->t)) --run->rows;
    for (; run->rows < run->points && near(run, run->times[run->rows], self->t); ++run->rows)
        if (record(self->fmu, run->recording, run->rows)) return CALL_FAILED;
    return DONE;
}

/* Makes the pair begin anew where the FMU is. */
static inline int begin(Exchange *self, double goal) {
    if (slope(&self->ode, self->t, self->x, self->k[0]) ||
        indicators_at(self, self->t, self->x, self->signs))
        return CALL_FAILED;
    self->h = fmin(first_step(&self->ode, self->t, goal - self->t, self->x, self->k),
                   (self->run->stop - self->run->start) / 50);
    forget_discards(self);
    return is_final(self) ? CALL_FAILED : DONE;
}

/* Steps until the next event or the end. Returns how the run goes on. */
static inline int until_event(Exchange *self, double goal, bool *event) {
    int how = begin(self, goal), rejected = 0;
    long long trials = 0, row = self->run->rows;
    while (how == DONE && !*event && self->t < goal) {
        if (halted) return INTERRUPTED;
        if (self->run->rows > row) {
            row = self->run->rows;
            trials = 0;
        }
        if (++trials > MOST_TRIED) return STEP_VANISHED;
        how = advance(self, goal, &rejected, event);
    }
    return how;
}

/* The FMU ends the run: where it is becomes the last row. */
static inline int ended(Exchange *self) {
    Run *run = self->run;
    if (run->rows > 0 && near(run, run->times[run->rows - 1], self->t)) --run->rows;
    if (run->rows == run->points) --run->rows;
    return record(self->fmu, run->recording, run->rows++) ? CALL_FAILED : ENDED_BY_FMU;
}

static inline int model_exchange(Run *run, Fmu *fmu) {
    Exchange self = {.run = run, .fmu = fmu, .t = run->start};
    self.ode = (Ode){exchange_slope, exchange_scale, &self};
    self.events = (Events){false, run->next_defined != 0, run->next_event};
    const Functions *call = fmu->call;
    if (run->states &&
        failed(fmu, "get_states", call->get_states(call->instance, self.x, (size_t)run->states)))
        return CALL_FAILED;
    if (record(fmu, run->recording, 0)) return CALL_FAILED;
    note(&self, false);
    run->rows = 1;
    for (int standing = 0; self.t < run->stop && run->rows < run->points;) {
        const double before = self.t;
        const bool timed = self.events.next_defined && self.events.next <= run->stop;
        double goal = timed ? self.events.next : run->stop;
        bool event = false;
        if (goal > self.t) {
            const int how = until_event(&self, goal, &event);
            if (how != DONE) return how == ENDED_BY_FMU ? ended(&self) : how;
        }
        if (timed && self.t >= goal) event = true;
        if (event) {
            const int how = handle_event(&self);
            if (how != DONE) return how == ENDED_BY_FMU ? ended(&self) : how;
        }
        if (self.t >= run->stop) return DONE;
        standing = self.t > before ? 0 : standing + 1;
        if (standing > MOST_STANDSTILLS) return STUCK;
    }
    return DONE;
}

SHARED void run_fmu(Run *run) {
    answer(run, model_exchange);
}

#endif
