/* A part for model exchange: its solver steps it as an FMU for co-simulation of FMI 3.0 steps.
 *
 * It is the pair of dop853.h, with the event search of model_exchange.h. Inputs follow their cubics
 * at each evaluation. A step returns early at an event, which happens in event mode.
 */
#ifndef EXCHANGE_PART_H
#define EXCHANGE_PART_H

#include <stdlib.h>

#include "model_exchange.h"

typedef struct {
    Run run;        /* of the FMU; nothing is recorded */
    Answer *inputs; /* NULL if they are constant within a step */
    int (*get_2)(void *, const uint32_t *, size_t, double *);
    int (*get_3)(void *, const uint32_t *, size_t, double *, size_t);
    long long saves;  /* whether the FMU saves its state; otherwise time and states are all of it */
    Functions *steps; /* the functions of the part, some of which are its solver's */
} Model;

typedef struct {
    Model *model;
    Fmu fmu;
    Exchange exchange;
    double passed; /* the time of the last event */
} Stepped;

enum { NUMBERS = 3 + NX + NZ };

/* What a step changes. */
typedef struct {
    double numbers[NUMBERS]; /* of the solver */
    void *state;             /* of the FMU */
} Saved;

/* A status for the master: a step that finds no end may be a shorter one. */
static inline int status_of(Stepped *self, int how) {
    const int vanished = how == STEP_VANISHED;
    self->model->run.function =
        vanished ? "the integration (step size too small, or too many steps)" : self->fmu.function;
    return how == DONE                               ? OK
           : vanished || self->fmu.status == DISCARD ? DISCARD
           : self->fmu.status != OK                  ? self->fmu.status
                                                     : FAILED;
}

/* The distance from which on the master tells times apart, some times over. */
static inline double resolution(const Run *run, double t) {
    const double rounding = rounding_of_times(run->stop - run->start, t);
    return 4 * fmax(rounding, 1e-12 * (t - run->start));
}

/* Go on to the edge of what the master takes for the start of the step, over events there. Tells
 * whether one is left at the edge. */
static inline int pass_edge(Stepped *self, double edge, bool *event) {
    Exchange *solver = &self->exchange;
    double before[NZ], z[NZ];
    memcpy(before, solver->signs, sizeof before);
    bool any = false;
    while (solver->t < edge) {
        bool passed = false;
        const int how = until_event(solver, edge, &passed);
        if (how != DONE) return how;
        any |= passed;
    }
    memcpy(solver->signs, before, sizeof before);
    if (indicators_at(solver, edge, solver->x, z)) return CALL_FAILED;
    *event = crossed(solver, z) || (any && !self->model->run.indicators);
    memcpy(solver->signs, z, sizeof z);
    return DONE;
}

/* Steps to an event or a time. An event has to be far enough behind the start for the inputs to
 * show it. */
static inline int step_until(Stepped *self, double goal, bool *event) {
    Exchange *solver = &self->exchange;
    const double from = solver->t, edge = from + resolution(&self->model->run, from);
    double x[NX], signs[NZ];
    if (goal - from <= 4 * DBL_EPSILON * fmax(fabs(goal), fabs(from))) {
        solver->t = goal; /* as time is rounded */
        return DONE;
    }
    memcpy(x, solver->x, sizeof x);
    memcpy(signs, solver->signs, sizeof signs);
    const int how = until_event(solver, goal, event);
    if (how != DONE || !*event || solver->t >= edge || solver->t >= goal) return how;
    solver->t = from;
    memcpy(solver->x, x, sizeof x);
    memcpy(solver->signs, signs, sizeof signs);
    return pass_edge(self, fmin(edge, goal), event);
}

/* A step to an event or the end. What is to happen at its start, as inputs jump there, comes first.
 */
static int step_model(void *stepper, double t, double length, bool no_way_back, bool *event,
                      bool *terminate, bool *early, double *last) {
    Stepped *self = stepper;
    Exchange *solver = &self->exchange;
    const double goal = t + length;
    double z[NZ];
    (void)no_way_back;
    *event = *terminate = *early = false;
    self->fmu.function = NULL;
    self->fmu.status = OK;
    *last = self->model->run.time = solver->t = t;
    if (indicators_at(solver, t, solver->x, z)) return status_of(self, CALL_FAILED);
    const bool timed = solver->events.next_defined;
    if (crossed(solver, z) || (timed && solver->events.next <= t)) {
        *event = *early = true;
        return OK;
    }
    const int how = step_until(self, timed ? fmin(goal, solver->events.next) : goal, event);
    *terminate = how == ENDED_BY_FMU;
    if (how != DONE && how != ENDED_BY_FMU) return status_of(self, how);
    *event |= timed && solver->t >= solver->events.next;
    *early = *event && solver->t < goal;
    *last = solver->t;
    return status_of(self, move_fmu(solver, solver->t, solver->x) ? CALL_FAILED : DONE);
}

static int enter_events(void *stepper) {
    const Functions *call = ((Stepped *)stepper)->fmu.call;
    return call->enter_event_mode(call->instance);
}

static int update_model(void *stepper, bool *needed, bool *terminate, bool *nominals, bool *values,
                        bool *defined, double *next) {
    Stepped *self = stepper;
    Events *events = &self->exchange.events;
    if (update_once(&self->fmu, needed, events)) return status_of(self, CALL_FAILED);
    *terminate = events->terminate;
    *nominals = *values = false;
    *defined = events->next_defined;
    *next = events->next;
    return OK;
}

/* Back to continuous time; what the event has changed is where the next step begins. */
static int leave_events(void *stepper) {
    Stepped *self = stepper;
    Exchange *solver = &self->exchange;
    const Functions *call = self->fmu.call;
    self->passed = solver->t;
    const size_t n = (size_t)self->model->run.states, nz = (size_t)self->model->run.indicators;
    const int wrong = /* indicators are with the inputs of now */
        failed(&self->fmu, "enter_continuous_time_mode",
               call->enter_continuous_time_mode(call->instance)) ||
        (n && failed(&self->fmu, "get_states", call->get_states(call->instance, solver->x, n))) ||
        (nz && failed(&self->fmu, "get_indicators",
                      call->get_indicators(call->instance, solver->signs, nz)));
    return status_of(self, wrong ? CALL_FAILED : DONE);
}

/* Values on the line through the present state. */
static inline int outputs_at(Stepped *self, double t, const double *x, const uint32_t *references,
                             size_t n, double *y) {
    const Model *model = self->model;
    void *const instance = self->fmu.call->instance;
    if (move_fmu(&self->exchange, t, x)) return 1;
    return failed(&self->fmu, "an output",
                  model->get_2 ? model->get_2(instance, references, n, y)
                               : model->get_3(instance, references, n, y, n));
}

static const double SHARE = 1e-5;      /* of a solver's step, for differences */
static const double LEAST_MOVE = 1e-8; /* of states in them, of their size */
enum { POINTS = 3 };
static const double OFFSETS[2][POINTS] = {{-1, 1, 0}, {1, 2, 3}}; /* around, and on one side */
static const double WEIGHTS[2][POINTS] = {{-0.5, 0.5, 0}, {-2.5, 4, -1.5}};

/* The side of the present time on which the outputs go on smoothly: -1 before an event in reach of
 * differences over *d, 1 after one; 0 for both sides. From there on, *d reaches no other event of
 * time. Returns whether that failed. */
static inline int find_side(Stepped *self, double *d, int *side) {
    Exchange *solver = &self->exchange;
    const double t = solver->t, reach = OFFSETS[1][POINTS - 1] * *d;
    const double since = self->passed <= t ? t - self->passed : INFINITY;
    const double ahead = solver->events.next_defined ? solver->events.next - t : INFINITY;
    const int waits = ahead <= resolution(&self->model->run, t);
    double x[NX], z[NZ];
    *side = since <= reach && !waits ? 1 : -(ahead <= reach);
    if (*side) *d = fmin(*d, (*side > 0 ? ahead : since) / (POINTS + 1));
    for (int way = -1; self->model->run.indicators && way <= 1; way += 2) {
        for (int i = 0; i < NX; ++i) x[i] = solver->x[i] + way * reach * solver->k[0][i];
        if (indicators_at(solver, t + way * reach, x, z)) return 1;
        if (crossed(solver, z)) *side = -way;
    }
    return 0;
}

/* Derivatives of outputs by time while the inputs stay, by differences along the motion. */
static int rates_of_model(void *stepper, const uint32_t *references, size_t n,
                          const int32_t *orders, double *rates, size_t count) {
    Stepped *self = stepper;
    Exchange *solver = &self->exchange;
    const double t = solver->t, span = self->model->run.stop - self->model->run.start;
    double x[NX], y[TOGETHER], sum[TOGETHER] = {0};
    int side = 0;
    (void)orders, (void)count;
    self->fmu.function = NULL;
    self->fmu.status = OK;
    int wrong = n > TOGETHER || slope(&solver->ode, t, solver->x, solver->k[0]);
    double d = SHARE * span / 50;
    if (!wrong && self->model->run.states) {
        const double rate =
            self->model->run.relative_tolerance * norm(&solver->ode, solver->k[0], solver->x);
        const double own = SHARE * first_step(&solver->ode, t, span, solver->x, solver->k);
        d = fmin(d, fmax(own, LEAST_MOVE / rate));
        wrong = is_final(solver);
    }
    wrong = wrong || find_side(self, &d, &side);
    d = t + fmax(d, 1e4 * DBL_EPSILON * fabs(t)) - t; /* as both times are rounded */
    for (int point = 0; !wrong && point < POINTS; ++point) {
        const double move = (side ? side : 1) * OFFSETS[side != 0][point] * d;
        const double weight = (side ? side : 1) * WEIGHTS[side != 0][point];
        for (int i = 0; i < NX; ++i) x[i] = solver->x[i] + move * solver->k[0][i];
        wrong = outputs_at(self, t + move, x, references, n, y);
        for (size_t i = 0; !wrong && i < n; ++i) sum[i] += weight * y[i];
    }
    for (size_t i = 0; !wrong && i < n; ++i) rates[i] = sum[i] / d;
    const int status = wrong ? status_of(self, CALL_FAILED) : OK;
    return move_fmu(solver, t, solver->x) ? status_of(self, CALL_FAILED) : status;
}

static void copy_numbers_out(const Exchange *solver, double *numbers) {
    numbers[0] = solver->t;
    numbers[1] = solver->events.next_defined;
    numbers[2] = solver->events.next;
    memcpy(numbers + 3, solver->x, sizeof solver->x);
    memcpy(numbers + 3 + NX, solver->signs, sizeof solver->signs);
}

/* Sets the numbers of the solver, and time and states of the FMU. */
static int take_numbers(Stepped *self, const double *numbers) {
    Exchange *solver = &self->exchange;
    solver->t = numbers[0];
    solver->events = (Events){false, numbers[1] != 0, numbers[2]};
    memcpy(solver->x, numbers + 3, sizeof solver->x);
    memcpy(solver->signs, numbers + 3 + NX, sizeof solver->signs);
    return status_of(self, move_fmu(solver, solver->t, solver->x) ? CALL_FAILED : DONE);
}

static int save_model(void *stepper, void **place) {
    const Stepped *self = stepper;
    const Functions *call = self->fmu.call;
    Saved *saved = *place ? *place : calloc(1, sizeof *saved);
    if (!saved) return FAILED;
    *place = saved;
    copy_numbers_out(&self->exchange, saved->numbers);
    return self->model->saves ? call->get_fmu_state(call->instance, &saved->state) : OK;
}

static int restore_model(void *stepper, void *place) {
    Stepped *self = stepper;
    const Functions *call = self->fmu.call;
    const Saved *saved = place;
    const int status = self->model->saves ? call->set_fmu_state(call->instance, saved->state) : OK;
    return status > WARNING ? status : take_numbers(self, saved->numbers);
}

/* Copies the numbers of the solver to a place, or `in` from there; returns how many, or -1 if that
 * failed. */
SHARED long long numbers_of_model(const Functions *steps, double *place, int in) {
    Stepped *self = steps->stepper;
    if (place && !in) copy_numbers_out(&self->exchange, place);
    return place && in && take_numbers(self, place) > WARNING ? -1 : NUMBERS;
}

static int forget_model(void *stepper, void **place) {
    const Functions *call = ((const Stepped *)stepper)->fmu.call;
    Saved *saved = *place;
    if (saved && saved->state) call->free_fmu_state(call->instance, &saved->state);
    free(saved);
    *place = NULL;
    return OK;
}

/* Gives an FMU in event mode after its initialization a solver. Returns 0 unless there is no
 * memory; `close_model` frees it. */
SHARED int open_model(Model *model) {
    Stepped *self = calloc(1, sizeof *self);
    if (!self) return 1;
    self->model = model;
    self->fmu.call = model->run.functions;
    self->exchange = (Exchange){
        .run = &model->run, .fmu = &self->fmu, .t = model->run.start, .inputs = model->inputs};
    self->exchange.ode = (Ode){exchange_slope, exchange_scale, &self->exchange};
    Functions *steps = model->steps;
    *steps = *model->run.functions;
    self->passed = -INFINITY;
    steps->stepper = self;
    steps->do_step_3 = step_model;
    steps->enter_event_mode = enter_events;
    steps->update_discrete_states = update_model;
    steps->enter_step_mode = leave_events;
    steps->output_derivatives_3 = rates_of_model;
    steps->get_fmu_state = save_model;
    steps->set_fmu_state = restore_model;
    steps->free_fmu_state = forget_model;
    steps->do_step_2 = NULL; /* nothing of co-simulation of FMI 2 */
    steps->get_boolean_status = NULL;
    steps->new_discrete_states = NULL;
    steps->set_input_derivatives = NULL;
    steps->output_derivatives_2 = NULL;
    return 0;
}

SHARED void close_model(Functions *steps) {
    free(steps->stepper);
    steps->stepper = NULL;
}

#endif
