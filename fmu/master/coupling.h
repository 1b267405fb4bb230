/* Co-simulation of parts whose outputs drive inputs of other parts.
 *
 * At a communication point the interface is settled, see interface.h. Within a macro step each
 * input is a cubic through values and rates at both ends; the parts are rolled back and step again
 * until the interface at the end agrees with what they were given. What the cubic before the step
 * predicts for its end differs from that by four powers of the step: that is the estimate of the
 * error.
 *
 * Source  Arnold, Clauss, Schierz, Arch. Mech. Eng. 60, 2013, 75-94 (error of macro steps).
 */
#ifndef COUPLING_H
#define COUPLING_H

#include "interface.h"
#include "interrupt.h"

enum { MOST_POINTS = 3 }; /* of a prediction */
enum { MOST_ITERATIONS = 40, MOST_FORCED = 1000, MOST_PIECES = 10000 };

/* Differences that iterations leave, of the correction: where the error of a step is estimated, and
 * where the step is given. */
static const double AGREED = 1e-2, AGREED_IN_GIVEN_STEPS = 1e-4;
static const double DIVERGED = 1e3; /* times the difference of the first pass */
static const double SAFE = 0.8, SHORTER = 0.2, LONGER = 2.0; /* of macro steps */
static const double SHORTEST = 1e-9;                         /* macro step, of the span */
static const double LONGEST = 0.1;

/* A cubic by its derivatives at the time `since` after the first of two points. */
static inline void cubic_at(const Interface *a, const Interface *b, long long k, double since,
                            double derivatives[4]) {
    const double h = b->t - a->t, chord = (b->u[k] - a->u[k]) / h;
    const double second = 2 * (3 * chord - 2 * a->r[k] - b->r[k]) / h;
    const double third = 6 * (a->r[k] + b->r[k] - 2 * chord) / (h * h);
    derivatives[0] = a->u[k] + since * (a->r[k] + since * (second / 2 + since * third / 6));
    derivatives[1] = a->r[k] + since * (second + since * third / 2);
    derivatives[2] = second + since * third;
    derivatives[3] = third;
}

/* Give a part its inputs for a step of a length, as well as it takes them. */
static inline int drive(Coupling *self, const Part *part, double since, double length) {
    double *u = self->part_u, *by_order = self->given;
    const long long n = part->inputs, first = part->first_input;
    for (long long i = 0; i < n; ++i) {
        double d[4] = {self->next.u[first + i]};
        if (self->system->method >= EXTRAPOLATED)
            cubic_at(&self->now, &self->next, first + i, since, d);
        const double mean = d[0] + length * (d[1] / 2 + length * (d[2] / 6 + length * d[3] / 24));
        const double chord = d[1] + length * (d[2] / 2 + length * d[3] / 6);
        u[i] = part->order == MOST_ORDER ? d[0] : mean - (part->order ? chord * length / 2 : 0);
        by_order[i] = part->order == MOST_ORDER ? d[1] : chord;
        by_order[n + i] = d[2];
        by_order[2 * n + i] = d[3];
    }
    if (part_set(&self->fmu, part, u)) return 1;
    if (self->system->method < EXTRAPOLATED) return 0;
    for (int order = 1; order <= part->order; ++order)
        if (part_set_derivatives(&self->fmu, part, order, by_order + (order - 1) * n)) return 1;
    return 0;
}

/* Give a part the values of the cubics within a step. */
static inline int set_to_cubics(Coupling *self, const Part *part, double since) {
    if (self->system->method < EXTRAPOLATED) return 0;
    for (long long i = 0; i < part->inputs; ++i) {
        double d[4];
        cubic_at(&self->now, &self->next, part->first_input + i, since, d);
        self->part_u[i] = d[0];
    }
    return part_set(&self->fmu, part, self->part_u);
}

/* Which part steps. FMI 3 has no other way to tell the callback that FMPy leaves open. */
static _Thread_local struct {
    Coupling *coupling;
    const Part *part;
} stepping;

/* The callback of FMI 3: a part asks within its step for the inputs at a time. */
SHARED void give_inputs(void *environment, double time, bool asks, bool readable, bool finished,
                        bool may_return, bool *stops, double *until) {
    Coupling *self = stepping.coupling;
    (void)environment, (void)readable, (void)finished, (void)may_return, (void)until;
    *stops = false;
    if (asks && self) self->refused |= set_to_cubics(self, stepping.part, time - self->now.t);
}

/* Note by how much the outputs of a part differ from the cubics that they drive, within a step. */
static inline int compare_with_cubics(Coupling *self, const Part *part, double since) {
    const System *system = self->system;
    if (part_get(&self->fmu, part, self->y + part->first_output)) return 1;
    for (long long k = 0; k < system->inputs; ++k) {
        const long long output = system->source[k] - part->first_output;
        if (output < 0 || output >= part->outputs) continue;
        double d[4];
        cubic_at(&self->now, &self->next, k, since, d);
        const double off = fabs(driven(self, k) - d[0]) / size_of(system, k, d[0]);
        if (!(off <= self->mismatch)) self->mismatch = off;
    }
    return 0;
}

/* Whether a row is that of an output time before a time. */
static inline int is_before(const System *system, long long row, double t) {
    return row < system->points && system->times[row] < t && !near(system->times[row], t);
}

/* Into how many steps a part divides one: if it holds its inputs, into so many that their error
 * falls like the tolerance. */
static inline long long pieces_of(const Coupling *self, const Part *part, double since,
                                  double length) {
    const System *system = self->system;
    double change = 0;
    if (part->order || system->method < EXTRAPOLATED || system->tolerance <= 0) return 1;
    for (long long i = part->first_input; i < part->first_input + part->inputs; ++i) {
        double a[4], b[4];
        cubic_at(&self->now, &self->next, i, since, a);
        cubic_at(&self->now, &self->next, i, since + length, b);
        const double rate = fmax(fabs(a[1]), fabs(b[1]));
        change = fmax(change, rate * length / size_of(system, i, a[0]));
    }
    return 1 + (long long)fmin(change / sqrt(system->tolerance), MOST_PIECES);
}

/* Step a part from one time within the macro step to another. */
static inline int advance(Coupling *self, Part *part, double from, double to) {
    const double begin = self->now.t;
    const long long pieces = pieces_of(self, part, from - begin, to - from);
    double t = from;
    for (long long i = 1; i <= pieces; ++i) {
        const double end = i == pieces ? to : from + (to - from) * (double)i / (double)pieces;
        if (drive(self, part, t - begin, end - t)) return PART_FAILED;
        self->refused = 0;
        stepping.coupling = self;
        stepping.part = part;
        const int how = part_step(&self->fmu, part, t, end - t);
        stepping.coupling = NULL;
        if (how != STEPPED) return how;
        if (self->refused) return PART_FAILED;
        t = end;
    }
    return STEPPED;
}

/* Step a part to the end of the macro step; if it records, by way of the output times within. */
static inline int step_part(Coupling *self, Part *part, int recording) {
    const System *system = self->system;
    const double begin = self->now.t, end = self->next.t;
    double t = begin;
    long long row = system->rows;
    for (;; ++row) {
        const int last = !(recording && is_before(system, row, end));
        const double to = last ? end : system->times[row];
        const int how = to > t ? advance(self, part, t, to) : STEPPED;
        if (how != STEPPED) return how;
        t = to;
        if (last) return STEPPED;
        const int differs = part->order < MOST_ORDER; /* from the cubics, at the end of its step */
        if ((differs && set_to_cubics(self, part, t - begin)) || part_record(&self->fmu, part, row))
            return PART_FAILED;
        if (system->method >= EXTRAPOLATED && compare_with_cubics(self, part, t - begin))
            return PART_FAILED;
    }
}

/* Inputs of a part that the parts before it drive, which have stepped already: their values there.
 */
static inline int take_new_outputs(Coupling *self, long long p) {
    const System *system = self->system;
    const Part *part = system->parts + p;
    if (get_outputs(self, p)) return 1;
    for (long long k = part->first_input; k < part->first_input + part->inputs; ++k)
        if (system->source[k] < part->first_output) self->next.u[k] = driven(self, k);
    return 0;
}

/* Step all parts; from the second pass on those that roll back. */
static inline int step_parts(Coupling *self, int pass, int recording) {
    System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p) {
        Part *part = system->parts + p;
        system->part = p;
        if (pass > 0 && !part->rolls_back) continue;
        if (pass > 0 && part_restore(&self->fmu, part)) return PART_FAILED;
        if (system->method == GAUSS_SEIDEL && take_new_outputs(self, p)) return PART_FAILED;
        const int how = step_part(self, part, recording || !part->rolls_back);
        if (how != STEPPED) return how;
    }
    return STEPPED;
}

/* The polynomial through values and rates at the newest points, the present one among them, at the
 * next point. */
static inline void predict(const Coupling *self, int points, Interface *next) {
    const Interface *at[] = {&self->now, &self->past[0], &self->past[1]};
    const int n = 2 * (int)fmin((double)self->known + 1, points);
    for (long long k = 0; k < self->system->inputs; ++k) {
        double d[2 * MOST_POINTS], value = 0, rate = 0; /* divided differences, each point twice */
        for (int i = 0; i < n; ++i) d[i] = at[i / 2]->u[k];
        for (int order = 1; order < n; ++order)
            for (int i = n - 1; i >= order; --i) {
                const double apart = at[i / 2]->t - at[(i - order) / 2]->t;
                d[i] = apart != 0 ? (d[i] - d[i - 1]) / apart : at[i / 2]->r[k];
            }
        for (int i = n - 1; i >= 0; --i) {
            const double since = next->t - at[i / 2]->t;
            rate = value + since * rate;
            value = d[i] + since * value;
        }
        next->u[k] = value;
        next->r[k] = rate;
    }
}

static inline void copy(const Coupling *self, Interface *to, const Interface *from) {
    const size_t size = (size_t)self->system->inputs * sizeof *to->u;
    to->t = from->t;
    memcpy(to->u, from->u, size);
    memcpy(to->r, from->r, size);
}

/* The interface as one vector without units. */
static inline void as_vector(const Coupling *self, const Interface *at, double *w) {
    const long long m = self->system->inputs;
    const double h = self->next.t - self->now.t;
    for (long long k = 0; k < m; ++k) {
        const double size = size_of(self->system, k, self->now.u[k]);
        w[k] = at->u[k] / size;
        w[m + k] = h * at->r[k] / size;
    }
}

static inline void from_vector(const Coupling *self, const double *w, Interface *at) {
    const long long m = self->system->inputs;
    const double h = self->next.t - self->now.t;
    for (long long k = 0; k < m; ++k) {
        const double size = size_of(self->system, k, self->now.u[k]);
        at->u[k] = w[k] * size;
        at->r[k] = w[m + k] * size / h;
    }
}

static inline double largest(long long n, const double *a, const double *b) {
    double found = 0;
    for (long long i = 0; i < n; ++i) {
        const double difference = fabs(b ? a[i] - b[i] : a[i]);
        if (!(difference <= found)) found = difference;
    }
    return found;
}

enum { ACCEPTED, REJECTED, BROKEN }; /* a macro step */

static inline int may_be_shortened(const Coupling *self) {
    return self->all_roll_back && !self->system->macro_step;
}

/* What a part that did not make its step means for the macro step. */
static inline int after_failed_step(Coupling *self, int how) {
    System *system = self->system;
    if (how == NOT_STEPPED && may_be_shortened(self)) {
        self->fmu.function = NULL;
        return REJECTED;
    }
    system->how = how == PART_ENDED ? ENDED_BY_FMU : CALL_FAILED;
    return BROKEN;
}

static inline int settled_next(Coupling *self) {
    System *system = self->system;
    const int how = settle(self, &self->next);
    if (how == DONE) return ACCEPTED;
    if (how != CALL_FAILED && may_be_shortened(self)) return REJECTED;
    system->how = how;
    return BROKEN;
}

/* One macro step to `next.t`; `iterates`: until inputs and outputs at its end agree. `error` is the
 * estimate of the interface's error within, in scales. */
static inline int macro_step(Coupling *self, int iterates, double *error) {
    System *system = self->system;
    const long long m = system->inputs, n = 2 * m;
    const double share = system->macro_step > 0 ? AGREED_IN_GIVEN_STEPS : AGREED;
    const int records = is_before(system, system->rows, self->next.t);
    if (system->method >= EXTRAPOLATED)
        predict(self, 2, &self->next);
    else
        memcpy(self->next.u, self->now.u, (size_t)m * sizeof *self->next.u);
    double *predicted = self->found + n, *w = self->w;
    as_vector(self, &self->next, predicted);
    if (iterates) predict(self, MOST_POINTS, &self->next);
    as_vector(self, &self->next, w);
    double first = 0;
    int agreed = !iterates;
    for (int pass = 0; pass < MOST_ITERATIONS; ++pass) {
        ++system->iterations;
        const int recording = records && (agreed || pass >= self->agreed_at);
        self->mismatch = 0;
        const int how = step_parts(self, pass, recording);
        if (how != STEPPED) return after_failed_step(self, how);
        const int settled = settled_next(self);
        if (settled != ACCEPTED) return settled;
        as_vector(self, &self->next, self->found);
        if (agreed) break;
        for (long long i = 0; i < n; ++i) self->change[i] = self->found[i] - w[i];
        const double left = largest(n, self->change, NULL);
        const double correction = largest(n, self->found, predicted);
        if (pass == 0) first = left;
        if (!isfinite(left) || (left > DIVERGED * first && may_be_shortened(self))) return REJECTED;
        agreed = left <= fmax(share * correction, ROUNDED);
        if (agreed) self->agreed_at = pass;
        if (agreed && (recording || !records)) break;
        if (agreed)
            memcpy(w, self->found, (size_t)n * sizeof *w);
        else
            accelerate(&self->iteration, w, self->change, pass == 0);
        from_vector(self, w, &self->next);
    }
    if (!agreed) {
        if (may_be_shortened(self)) return REJECTED;
        ++system->unsettled;
    }
    const double h = self->next.t - self->now.t;
    const double before = self->known ? self->now.t - self->past[0].t : h;
    *error = largest(m, self->found, predicted) * pow(h / (h + before), 2) / 16;
    *error = fmax(*error, self->mismatch);
    return ACCEPTED;
}

/* -- the run ---------------------------------------------------------------------------------- */

static inline int record_all(Coupling *self) {
    System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p)
        if (part_record(&self->fmu, system->parts + p, system->rows)) return give_up(self, p);
    ++system->rows;
    return 0;
}

static inline int save_all(Coupling *self) {
    System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p)
        if (part_save(&self->fmu, system->parts + p)) return give_up(self, p);
    return 0;
}

static inline int restore_all(Coupling *self) {
    System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p)
        if (part_restore(&self->fmu, system->parts + p)) return give_up(self, p);
    return 0;
}

/* The point that has been reached becomes the present one. */
static inline int arrive(Coupling *self) {
    System *system = self->system;
    const Interface oldest = self->past[PAST - 1];
    for (int i = PAST - 1; i > 0; --i) self->past[i] = self->past[i - 1];
    self->past[0] = oldest;
    copy(self, &self->past[0], &self->now);
    if (self->known < PAST) ++self->known;
    copy(self, &self->now, &self->next);
    system->time = self->now.t;
    while (is_before(system, system->rows, self->now.t))
        ++system->rows; /* recorded within the step */
    if (system->rows < system->points && near(system->times[system->rows], self->now.t) &&
        record_all(self))
        return 1;
    for (long long k = 0; k < system->inputs; ++k)
        if (system->grows[k]) system->scale[k] = fmax(system->scale[k], fabs(self->now.u[k]));
    ++system->macro_steps;
    return 0;
}

static inline int run_adaptive(Coupling *self) {
    System *system = self->system;
    const double span = system->stop - system->start;
    double h = 1e-3 * span;
    long long forced = 0;
    while (system->time < system->stop && !near(system->time, system->stop)) {
        if (halted) return INTERRUPTED;
        const int last = system->time + 1.01 * h >= system->stop;
        double error = 0;
        self->next.t = last ? system->stop : system->time + h;
        const double length = self->next.t - self->now.t;
        if (save_all(self)) return CALL_FAILED;
        const int how = macro_step(self, system->method == ITERATED, &error);
        if (how == BROKEN) return (int)system->how;
        const int shortest = length <= SHORTEST * span;
        const int too_far = error > system->tolerance && self->all_roll_back;
        const double factor =
            how == REJECTED ? 0.25 : SAFE * pow(system->tolerance / fmax(error, 1e-300), 0.25);
        if (how == REJECTED || (too_far && !shortest)) {
            if (shortest) return STEP_VANISHED;
            ++system->rejected;
            if (restore_all(self)) return CALL_FAILED;
            h = length * fmin(fmax(factor, SHORTER), SAFE);
            continue;
        }
        if (too_far && ++forced > MOST_FORCED) return STEP_VANISHED;
        if (arrive(self)) return CALL_FAILED;
        h = fmin(fmax(length * fmin(fmax(factor, SHORTER), LONGER), SHORTEST * span),
                 LONGEST * span);
    }
    return DONE;
}

static inline int run_fixed(Coupling *self) {
    System *system = self->system;
    for (long long n = 1; system->time < system->stop && !near(system->time, system->stop); ++n) {
        if (halted) return INTERRUPTED;
        double error = 0;
        self->next.t = fmin(system->start + (double)n * system->macro_step, system->stop);
        if (near(self->next.t, system->stop)) self->next.t = system->stop;
        const int begins = system->method == EXTRAPOLATED && n == 1 && self->all_roll_back;
        const int iterates = system->method == ITERATED || begins;
        if (iterates && save_all(self)) return CALL_FAILED;
        const int how = macro_step(self, iterates, &error);
        if (how == BROKEN) return (int)system->how;
        if (how == REJECTED) return NOT_A_NUMBER;
        system->mismatch = fmax(system->mismatch, self->mismatch);
        if (arrive(self)) return CALL_FAILED;
    }
    return DONE;
}

static inline double *take(double **memory, long long count) {
    double *taken = *memory;
    *memory += count;
    return taken;
}

/* Room for everything: returns 0 unless there is none. */
static inline int make_room(Coupling *self) {
    const long long m = self->system->inputs + 1, y = self->system->outputs + 1, n = 2 * m;
    const long long count =
        2 * m * (2 + PAST) + 2 * y + 2 * m * m + 4 * m + n + 3 * n + n * (2 + 3 * MOST_KEPT);
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
    self->change = take(&memory, n);
    self->w = take(&memory, n);
    self->found = take(&memory, 2 * n);
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

static inline int run_from_start(Coupling *self) {
    System *system = self->system;
    const long long m = system->inputs;
    self->now.t = system->time = system->start;
    memcpy(self->now.u, system->u, (size_t)m * sizeof *self->now.u);
    self->all_roll_back = 1;
    for (long long p = 0; p < system->n_parts; ++p)
        self->all_roll_back &= system->parts[p].rolls_back != 0;
    for (long long i = 0; i < system->outputs * m; ++i) self->feedthrough |= system->feeds[i] != 0;
    const int how = settle(self, &self->now);
    if (how != DONE) return how;
    if (record_all(self)) return CALL_FAILED;
    return system->macro_step > 0 ? run_fixed(self) : run_adaptive(self);
}

/* Settles the inputs of parts in initialization mode, whose start values may follow from them. */
static inline int settle_start(Coupling *self) {
    self->feedthrough = 1;
    return settle_values(self, self->system->u);
}

static inline void answer_of(System *system, int (*task)(Coupling *)) {
    Coupling self = {.system = system, .fmu = {NULL, NULL, OK}};
    system->part = system->input = -1;
    for (long long p = 1; p < system->n_parts; ++p) {
        const Part *before = system->parts + p - 1;
        system->parts[p].first_input = before->first_input + before->inputs;
        system->parts[p].first_output = before->first_output + before->outputs;
    }
    system->how = make_room(&self) ? CALL_FAILED : task(&self);
    system->function = self.fmu.function;
    system->status = self.fmu.status;
    for (long long p = 0; p < system->n_parts; ++p) part_forget(system->parts + p);
    free(self.memory);
}

#endif
