/* A coupled system that stays open: it is begun, goes on to one goal after the other, and is
 * closed.
 *
 * Between these calls values may be set, and the numbers with which the next macro step begins can
 * be copied out and in; the states of the parts are their own.
 */
#ifndef OPEN_SYSTEM_H
#define OPEN_SYSTEM_H

#include "coupling.h"

static inline double *take(double **memory, long long count) {
    double *taken = *memory;
    *memory += count;
    return taken;
}

/* Room for everything: returns 0 unless there is none. */
static inline int make_room(Coupling *self) {
    const long long m = self->system->inputs + 1, y = self->system->outputs + 1, n = 2 * m;
    const long long count =
        2 * m * (2 + PAST) + 2 * y + 2 * m * m + 5 * m + n + 4 * n + n * (2 + 3 * MOST_KEPT);
    double *memory = self->memory = calloc((size_t)count, sizeof *memory);
    if (!memory) return 1;
    Interface *points[2 + PAST] = {&self->now, &self->next};
    for (int i = 0; i < PAST; ++i) points[2 + i] = &self->past[i];
    for (int i = 0; i < 2 + PAST; ++i) {
        points[i]->u = take(&memory, m);
        points[i]->r = take(&memory, m);
    }
    self->y = take(&memory, y);
    self->column = take(&memory, y);
    self->gain = take(&memory, m * m);
    self->matrix = take(&memory, m * m);
    self->part_u = take(&memory, m);
    self->given = take(&memory, 3 * m);
    self->jumps = take(&memory, m);
    self->change = take(&memory, n);
    self->w = take(&memory, n);
    self->found = take(&memory, 2 * n);
    self->best = take(&memory, n);
    FixedPoint *iteration = &self->iteration;
    iteration->n = 2 * self->system->inputs;
    iteration->w = take(&memory, n);
    iteration->f = take(&memory, n);
    for (int j = 0; j < MOST_KEPT; ++j) {
        iteration->dw[j] = take(&memory, n);
        iteration->df[j] = take(&memory, n);
        iteration->q[j] = take(&memory, n);
    }
    return 0;
}

/* Threads for the parts, if they are wanted: returns 0 unless there is no memory. */
static inline int gather_crew(Coupling *self) {
    const System *system = self->system;
    const long long n = system->n_parts, m = system->inputs + 1;
    if (!system->threads || system->method == GAUSS_SEIDEL || n < 2) return 0;
    Stepper *steppers = calloc((size_t)n, sizeof *steppers);
    double *numbers = calloc((size_t)(4 * n * m), sizeof *numbers);
    self->crew = (Crew){step_member, (char *)steppers, sizeof *steppers, n, 0, NULL};
    self->crew_numbers = numbers;
    if (!steppers || !numbers) return 1;
    for (long long i = 0; i < n; ++i) {
        steppers[i].part_u = take(&numbers, m);
        steppers[i].given = take(&numbers, 3 * m);
    }
    crew_start(&self->crew);
    return 0;
}

static inline int begin_run(Coupling *self) {
    System *system = self->system;
    const long long m = system->inputs;
    self->now.t = system->time = system->start;
    forget_event(self);
    memcpy(self->now.u, system->u, (size_t)m * sizeof *self->now.u);
    self->all_roll_back = 1;
    for (long long p = 0; p < system->n_parts; ++p)
        self->all_roll_back &= system->parts[p].rolls_back != 0;
    self->ends_at_end = self->all_roll_back && !system->quantum;
    self->ends_at_events = self->ends_at_end && system->method >= EXTRAPOLATED;
    for (long long i = 0; i < system->outputs * m; ++i) self->feedthrough |= system->feeds[i] != 0;
    int in_event_mode = 0; /* after the initialization */
    for (long long p = 0; p < system->n_parts; ++p)
        in_event_mode |= system->parts[p].event_mode != 0;
    self->rateless = 1;
    const int how = in_event_mode ? let_happen(self) : settle(self, &self->now);
    if (how != DONE) return how;
    extend_ranges(self);
    const int recorded = record_next(self);
    if (recorded != DONE) return recorded;
    self->h = first_length(self);
    if (gather_crew(self)) return CALL_FAILED;
    const int passed = pass_due_events(self);
    if (passed != DONE || system->macro_step > 0) return passed;
    if (save_all(self)) return CALL_FAILED;
    return is_noisy(self, self->h, system->tolerance) ? NOISY : DONE;
}

/* Settles the inputs of parts in initialization mode, whose start values may follow from them. */
static inline int settle_start(Coupling *self) {
    const System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p)
        if (part_read_arrays(&self->fmu, system->parts + p, self->part_u))
            return give_up(self, p), CALL_FAILED;
    self->feedthrough = 1;
    return settle_values(self, self->system->u);
}

static inline int prepare(Coupling *self, System *system) {
    if (!system->texts) system->texts = new_texts();
    *self = (Coupling){.system = system, .fmu = {.called = system->called, .texts = system->texts}};
    for (long long p = 1; p < system->n_parts; ++p) {
        const Part *before = system->parts + p - 1;
        system->parts[p].first_input = before->first_input + before->inputs;
        system->parts[p].first_output = before->first_output + before->outputs;
        system->parts[p].place = p;
    }
    return !system->texts || make_room(self);
}

/* Carry out a task; the answer stands in the system. */
static inline void carry_out(Coupling *self, int (*task)(Coupling *)) {
    System *system = self->system;
    system->part = system->input = -1;
    self->fmu.function = NULL;
    self->fmu.status = OK;
    system->how = task(self);
    system->function = self->fmu.function;
    system->status = self->fmu.status;
}

static inline void dissolve(Coupling *self) {
    System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p) part_forget(system->parts + p);
    if (self->crew.count) crew_end(&self->crew);
    free(self->memory);
    free(self->crew.members);
    free(self->crew_numbers);
}

static inline void drop_texts(System *system) {
    free_texts(system->texts);
    system->texts = NULL;
}

SHARED void settle_coupled(System *system) {
    Coupling self;
    system->how = CALL_FAILED;
    if (!prepare(&self, system)) carry_out(&self, settle_start);
    dissolve(&self);
    if (system->how != DONE) drop_texts(system);
}

/* Begins a run of parts that have left initialization mode; `close_coupled` ends it, whatever the
 * answer is. */
SHARED void open_coupled(System *system) {
    Coupling *self = system->coupling = calloc(1, sizeof *self);
    system->how = CALL_FAILED;
    if (self && !prepare(self, system)) carry_out(self, begin_run);
}

SHARED void close_coupled(System *system) {
    if (system->coupling) dissolve(system->coupling);
    free(system->coupling);
    system->coupling = NULL;
    drop_texts(system);
}

/* Goes on to `goal`. */
SHARED void advance_coupled(System *system) {
    system->forced = 0;
    carry_out(system->coupling, go_on);
}

static inline int take_changes(Coupling *self) {
    forget_past(self);
    self->h = first_length(self);
    const int how = settle_values(self, self->now.u);
    return how == DONE ? let_happen(self) : how;
}

/* Takes the parts to event mode, so that values can be set. */
SHARED void begin_changes(System *system) {
    carry_out(system->coupling, enter_event_modes);
}

/* Lets the parts answer to values that were set. */
SHARED void end_changes(System *system) {
    carry_out(system->coupling, take_changes);
}

static inline void copy_numbers(double **place, double *own, long long n, int in) {
    memcpy(in ? own : *place, in ? *place : own, (size_t)n * sizeof *own);
    *place += n;
}

static inline void copy_count(double **place, long long *own, int in) {
    double value = (double)*own;
    copy_numbers(place, &value, 1, in);
    *own = (long long)value;
}

enum { OWN_NUMBERS = 13 };

static inline void copy_own_numbers(Coupling *self, double **place, int in) {
    System *system = self->system;
    double stop = system->stop;
    copy_count(place, &self->known, in);
    copy_count(place, &self->rateless, in);
    copy_count(place, &self->looked, in);
    copy_count(place, &self->agreed_at, in);
    copy_count(place, &self->given_steps, in);
    copy_count(place, &self->slow, in);
    copy_count(place, &self->window.made, in);
    copy_count(place, &self->window.rejected, in);
    copy_numbers(place, &self->window.begin, 1, in);
    copy_numbers(place, &self->most, 1, in);
    copy_numbers(place, &self->h, 1, in);
    copy_numbers(place, &system->start, 1, in);
    copy_numbers(place, &stop, 1, in);
    if (!system->ends) system->stop = stop;
}

/* Inputs that do not move, texts among them, have no other number than their outputs have now. */
static inline int find_held(Coupling *self) {
    System *system = self->system;
    if (get_outputs(self)) return CALL_FAILED;
    for (long long k = 0; k < system->inputs; ++k)
        if (system->held[k]) self->now.u[k] = driven(self, k);
    return DONE;
}

/* Copies the numbers of the next macro step to a place, or `in` from there; returns how many. */
SHARED long long numbers_of_coupled(System *system, double *place, int in) {
    Coupling *self = system->coupling;
    const long long m = system->inputs, parts = system->n_parts;
    const long long count = OWN_NUMBERS + (2 * m + 1) * (1 + PAST) + m + 2 * parts;
    if (!place) return count;
    copy_own_numbers(self, &place, in);
    for (int i = -1; i < PAST; ++i) {
        Interface *at = i < 0 ? &self->now : self->past + i;
        copy_numbers(&place, &at->t, 1, in);
        copy_numbers(&place, at->u, m, in);
        copy_numbers(&place, at->r, m, in);
    }
    copy_numbers(&place, system->scale, m, in);
    for (long long p = 0; p < parts; ++p) {
        Part *part = system->parts + p;
        copy_numbers(&place, &part->next_event, 1, in);
        copy_count(&place, &part->violations, in);
        if (!in) continue;
        part->waits = part->ends = 0;
        part->in_step_mode = part->event_mode; /* as between macro steps */
    }
    if (!in) return count;
    system->time = self->now.t;
    system->rows = 1;
    self->powers = 0;
    forget_event(self);
    carry_out(self, find_held);
    return count;
}

#endif
