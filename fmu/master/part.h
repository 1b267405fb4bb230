/* A part of a coupled system: an FMU with the inputs that outputs drive. One for model exchange
 * steps by functions of exchange_part.h, which are those of co-simulation of FMI 3.0. */
#ifndef PART_H
#define PART_H

#include "recording.h"

enum { MOST_ORDER = 3 }; /* of derivatives of inputs */

typedef struct {
    const Functions *call;
    const Recording *recording, *given, *shown; /* given: its inputs, shown: its outputs */
    const Recording *steady;   /* inputs that may be set outside event mode: the first ones */
    long long place, turn;     /* among the parts; when it steps */
    long long inputs, outputs; /* connected ones */
    long long first_input, first_output;     /* where they begin among those of all parts */
    long long moving_inputs, moving_outputs; /* the first ones, which are real and continuous */
    const uint32_t *input_references, *output_references; /* of these */
    long long order;      /* of derivatives of inputs that it takes, 0 to MOST_ORDER */
    long long rates;      /* whether it gives derivatives of outputs */
    long long rolls_back; /* whether its state can be saved and restored */
    long long directional;
    long long event_mode; /* whether its steps end at events, which happen in event mode */
    double own_step;      /* the only length of its steps; 0 if it takes any */
    /* answers */
    long long steps, restored;
    long long violations, kept; /* of validity conditions: so far; at `saved` */
    long long waits;            /* whether an event is to happen where it is */
    long long in_step_mode;     /* unless it is in event mode, or has not begun */
    long long ends;             /* whether it has ended the run where it is */
    double reached;
    double next_event, kept_next; /* the time of the event that it has announced; at `saved` */
    void *saved;                  /* its state at the last communication point; NULL at first */
} Part;

/* The functions of a part that is about to be called. */
static inline const Functions *calls_of(Fmu *fmu, const Part *self) {
    if (fmu->called) *fmu->called = self->place;
    return fmu->call = self->call;
}

static inline size_t together(long long left) {
    return (size_t)(left < TOGETHER ? left : TOGETHER);
}

static inline int part_get(Fmu *fmu, const Part *self, double *y) {
    calls_of(fmu, self);
    return get_row(fmu, self->shown, y);
}

static inline int part_set(Fmu *fmu, const Part *self, const double *u) {
    calls_of(fmu, self);
    return !self->ends && set_row(fmu, self->in_step_mode ? self->steady : self->given, u);
}

/* Reads arrays of which only some elements are inputs here; `u` is for its inputs. */
static inline int part_read_arrays(Fmu *fmu, const Part *self, double *u) {
    int scalars = 1;
    for (long long g = 0; g < self->given->groups; ++g)
        scalars &= self->given->group[g].values == self->given->group[g].count;
    if (scalars) return 0;
    calls_of(fmu, self);
    return get_row(fmu, self->given, u) || get_row(fmu, self->steady, u);
}

/* Derivatives of one order of the inputs that move, for the next step; an FMU of version 3 asks
 * instead. */
static inline int part_set_derivatives(Fmu *fmu, const Part *self, int order,
                                       const double *values) {
    const Functions *call = calls_of(fmu, self);
    int32_t orders[TOGETHER];
    if (!call->set_input_derivatives) return 0;
    for (int k = 0; k < TOGETHER; ++k) orders[k] = order;
    for (long long i = 0; i < self->moving_inputs; i += TOGETHER)
        if (failed(fmu, "set_input_derivatives",
                   call->set_input_derivatives(call->instance, self->input_references + i,
                                               together(self->moving_inputs - i), orders,
                                               values + i)))
            return 1;
    return 0;
}

/* First derivatives by time of the outputs that move; NaN for others. */
static inline int part_rates(Fmu *fmu, const Part *self, double *rates) {
    const Functions *call = calls_of(fmu, self);
    int32_t orders[TOGETHER];
    for (int k = 0; k < TOGETHER; ++k) orders[k] = 1;
    for (long long i = self->moving_outputs; i < self->outputs; ++i) rates[i] = NAN;
    for (long long i = 0; i < self->moving_outputs; i += TOGETHER) {
        const uint32_t *references = self->output_references + i;
        const size_t n = together(self->moving_outputs - i);
        if (call->output_derivatives_2
                ? failed(
                      fmu, "output_derivatives_2",
                      call->output_derivatives_2(call->stepper, references, n, orders, rates + i))
                : failed(fmu, "output_derivatives_3",
                         call->output_derivatives_3(call->stepper, references, n, orders, rates + i,
                                                    n)))
            return 1;
    }
    return 0;
}

/* Derivatives of all outputs by one input. */
static inline int part_column(Fmu *fmu, const Part *self, long long input, double *column) {
    const Functions *call = calls_of(fmu, self);
    const uint32_t *unknown = self->output_references, *known = self->input_references + input;
    const size_t n = (size_t)self->outputs;
    const double seed = 1;
    if (call->version == 2)
        return failed(fmu, "directional_2",
                      call->directional_2(call->instance, unknown, n, known, 1, &seed, column));
    return failed(fmu, "directional_3",
                  call->directional_3(call->instance, unknown, n, known, 1, &seed, 1, column, n));
}

static inline int part_save(Fmu *fmu, Part *self) {
    if (!self->rolls_back) return 0;
    self->kept = self->violations;
    self->kept_next = self->next_event;
    const Functions *call = calls_of(fmu, self);
    return failed(fmu, "get_fmu_state", call->get_fmu_state(call->stepper, &self->saved));
}

static inline int part_restore(Fmu *fmu, Part *self) {
    ++self->restored;
    self->waits = self->ends = 0;
    self->violations = self->kept;
    self->next_event = self->kept_next;
    const Functions *call = calls_of(fmu, self);
    return failed(fmu, "set_fmu_state", call->set_fmu_state(call->stepper, self->saved));
}

static inline void part_forget(Part *self) {
    const Functions *call = self->call;
    if (self->saved && !*call->is_fatal) call->free_fmu_state(call->stepper, &self->saved);
}

/* Writes a row of what the part records. */
static inline int part_record(Fmu *fmu, const Part *self, long long row) {
    calls_of(fmu, self);
    return record(fmu, self->recording, row);
}

enum { STEPPED, NOT_STEPPED, AT_EVENT, PART_ENDED, PART_FAILED, INPUT_NOT_FINITE };

/* A communication step, after which a state may be restored. A part that ends the run within it
 * says so; one that does not make the step may take a shorter one. It may reach an event only. */
static inline int part_step(Fmu *fmu, Part *self, double time, double length) {
    const Functions *call = calls_of(fmu, self);
    bool event = false, terminate = false, early = false;
    double last = time + length; /* of the solver inside, which may be behind the step's end */
    int status;
    ++self->steps;
    if (call->do_step_2)
        status = call->do_step_2(call->stepper, time, length, !self->rolls_back);
    else
        status = call->do_step_3(call->stepper, time, length, !self->rolls_back, &event, &terminate,
                                 &early, &last);
    const char *function = call->do_step_2 ? "do_step_2" : "do_step_3";
    if (status == DISCARD) {
        int terminated = 0;
        if (call->get_boolean_status)
            call->get_boolean_status(call->instance, TERMINATED, &terminated);
        if (!terminated) return failed(fmu, function, status), NOT_STEPPED;
        terminate = true;
        last = time; /* which fmax returns instead of NaN */
        call->get_real_status(call->instance, LAST_SUCCESSFUL_TIME, &last);
        last = fmax(last, time);
    } else if (failed(fmu, function, status)) { /* from an error, a saved state leads back */
        return status == FAILED && self->saved ? NOT_STEPPED : PART_FAILED;
    }
    const double end = time + length;
    if (terminate) last = last >= time ? fmin(last, end) : end; /* not all files tell where */
    /* an event just behind the end may have been reached already */
    self->reached = early || terminate ? last : event ? fmax(last, end) : end;
    self->waits = event && self->event_mode;
    self->ends = terminate;
    return terminate ? PART_ENDED : self->waits ? AT_EVENT : STEPPED;
}

static inline int part_enter_event_mode(Fmu *fmu, Part *self) {
    const Functions *call = calls_of(fmu, self);
    self->in_step_mode = 0;
    return failed(fmu, "enter_event_mode", call->enter_event_mode(call->stepper));
}

static inline int part_enter_step_mode(Fmu *fmu, Part *self) {
    const Functions *call = calls_of(fmu, self);
    self->waits = 0;
    self->in_step_mode = 1;
    return failed(fmu, "enter_step_mode", call->enter_step_mode(call->stepper));
}

/* What happens at an event, in event mode. */
static inline int part_update(Fmu *fmu, Part *self) {
    Events events = {0};
    calls_of(fmu, self);
    if (update(fmu, &events)) return PART_FAILED;
    self->next_event = events.next_defined ? events.next : INFINITY;
    self->ends = events.terminate;
    return self->ends ? PART_ENDED : STEPPED;
}

#endif
