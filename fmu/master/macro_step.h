/* One macro step of coupled parts.
 *
 * Each input is a cubic through values and rates at both ends; the parts are rolled back and step
 * again until the interface at the end agrees with what they were given. What the cubic before the
 * step predicts for its end differs from that by four powers of the step: that is the estimate of
 * the error. After an event, outputs in the middle of the step tell it.
 *
 * Source  Arnold, Clauss, Schierz, Arch. Mech. Eng. 60, 2013, 75-94 (error of macro steps).
 */
#ifndef MACRO_STEP_H
#define MACRO_STEP_H

#include "interrupt.h"
#include "prediction.h"

enum { MOST_ITERATIONS = 40, MOST_IDLE = 10, MOST_PIECES = 10000 };

/* Differences that iterations leave, of the correction: where the error of a step is estimated, and
 * where the step is given. */
static const double AGREED = 2e-3, AGREED_IN_GIVEN_STEPS = 1e-4;
static const double SHORTEST = 1e-9; /* macro step, of the span */
static const double DIVERGED = 1e3;  /* times the difference of the first pass */

/* The cubic of an input within the macro step by its derivatives at the time `since` its start; one
 * that has jumped there is the line through value and rate at the end. */
static inline void cubic_at(const Coupling *self, long long k, double since,
                            double derivatives[4]) {
    const Interface *a = &self->now, *b = &self->next;
    const double h = b->t - a->t, difference = b->u[k] - a->u[k];
    if (self->jumps[k] != 0) {
        derivatives[0] = b->u[k] - (h - since) * b->r[k];
        derivatives[1] = b->r[k];
        derivatives[2] = derivatives[3] = 0;
        return;
    }
    const double rounding = 8 * DBL_EPSILON * fmax(fabs(a->u[k]), fabs(b->u[k]));
    const double chord = /* the rates tell it where the values are too near to each other */
        fabs(difference) <= rounding ? (a->r[k] + b->r[k]) / 2 : difference / h;
    double second = 2 * (3 * chord - 2 * a->r[k] - b->r[k]) / h;
    double third = 6 * (a->r[k] + b->r[k] - 2 * chord) / (h * h);
    const int judged = self->looks || (self->powers && isfinite(self->middle));
    if (judged && a->r[k] == 0 && second * chord < 0) {
        second = 0; /* as of a higher power of time, not first to the other side */
        third = 6 * chord / (h * h);
    }
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
        if (self->system->method >= EXTRAPOLATED) cubic_at(self, first + i, since, d);
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
        cubic_at(self, part->first_input + i, since, d);
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
    if (!asks || !self) return;
    /* where it has had an event, its own time may be off by rounding; its inputs are not */
    const double since = same_time(self->system, time, self->now.t) ? 0 : time - self->now.t;
    self->refused |= set_to_cubics(self, stepping.part, since);
}

/* Note by how much the outputs of a part differ from the cubics that they drive, within a step. */
static inline int compare_with_cubics(Coupling *self, const Part *part, double since) {
    const System *system = self->system;
    if (part_get(&self->fmu, part, self->y + part->first_output)) return 1;
    for (long long k = 0; k < system->inputs; ++k) {
        const long long output = system->source[k] - part->first_output;
        if (output < 0 || output >= part->outputs) continue;
        double d[4];
        cubic_at(self, k, since, d);
        double off = fabs(driven(self, k) - d[0]) / size_of(system, k, d[0]);
        if (system->held[k]) off = off > 0 && !system->macro_step ? INFINITY : 0; /* it switches */
        if (!(off <= self->mismatch)) self->mismatch = off;
    }
    return 0;
}

/* Whether a row is that of an output time before a time. */
static inline int is_before(const System *system, long long row, double t) {
    return row < system->points && system->times[row] < t &&
           !same_time(system, system->times[row], t);
}

/* Into how many steps a part divides one: if it holds its inputs, into so many that their error
 * falls like the tolerance. */
static inline long long pieces_of(const Coupling *self, const Part *part, double since,
                                  double length) {
    const System *system = self->system;
    double change = 0;
    if (part->own_step > 0) return llround(length / part->own_step);
    if (part->order || system->method < EXTRAPOLATED || system->macro_step > 0) return 1;
    for (long long i = part->first_input; i < part->first_input + part->inputs; ++i) {
        double a[4], b[4];
        cubic_at(self, i, since, a);
        cubic_at(self, i, since + length, b);
        const double rate = fmax(fabs(a[1]), fabs(b[1]));
        change = fmax(change, rate * length / size_of(system, i, a[0]));
    }
    return 1 + (long long)fmin(change / sqrt(system->tolerance), MOST_PIECES);
}

/* An event of a part that does not end the macro step: what its outputs do there, no later point
 * tells. */
static inline int part_passes_event(Coupling *self, Part *part) {
    if (part_enter_event_mode(&self->fmu, part)) return PART_FAILED;
    const int how = part_update(&self->fmu, part);
    if (how != STEPPED) return how;
    if (part_enter_step_mode(&self->fmu, part)) return PART_FAILED;
    const int alone = self->system->method < EXTRAPOLATED;
    return alone && compare_with_cubics(self, part, 0) ? PART_FAILED : STEPPED;
}

/* Step a part with one polynomial per input, by way of its events. */
static inline int step_through(Coupling *self, Part *part, double from, double to) {
    const double begin = self->now.t;
    double t = from;
    int alone = 0; /* whether an event is by inputs that the part holds: others do not see it */
    for (int standstills = 0; standstills < MOST_UPDATES && !halted; ++standstills) {
        if (!alone && drive(self, part, t - begin, to - t)) return PART_FAILED;
        self->refused = 0;
        stepping.coupling = self;
        stepping.part = part;
        int how = part_step(&self->fmu, part, t, part->own_step > 0 ? part->own_step : to - t);
        stepping.coupling = NULL;
        alone = how == AT_EVENT && part->order == 0 &&
                !same_time(self->system, part->reached, part->next_event);
        const int passes = alone || (!self->ends_at_events &&
                                     !same_time(self->system, part->reached, self->next.t));
        if (how == AT_EVENT && passes) how = part_passes_event(self, part);
        if (how != STEPPED) return how;
        if (self->refused) return PART_FAILED;
        if (!same_time(self->system, part->reached, t)) standstills = 0;
        t = part->reached;
        if (t >= to || (!alone && same_time(self->system, t, to))) return STEPPED;
    }
    failed(&self->fmu, "the iteration of events at one instant", FAILED);
    return PART_FAILED;
}

/* Step a part from one time within the macro step to another. */
static inline int advance(Coupling *self, Part *part, double from, double to) {
    const double begin = self->now.t;
    const long long pieces = pieces_of(self, part, from - begin, to - from);
    double t = from;
    for (long long i = 1; i <= pieces; ++i) {
        const double end = i == pieces ? to : from + (to - from) * (double)i / (double)pieces;
        const int how = step_through(self, part, t, end);
        if (how != STEPPED) return how;
        t = end;
    }
    return STEPPED;
}

/* Step a part to the end of the macro step; if it records, by way of the output times within. */
static inline int step_part(Coupling *self, Part *part, int recording) {
    const System *system = self->system;
    const double begin = self->now.t, end = self->next.t;
    double t = begin, middle = self->middle;
    long long row = system->rows;
    for (;;) {
        const int records = recording && is_before(system, row, end);
        const double stop = records ? system->times[row] : end;
        const int compares = middle < stop && !same_time(system, middle, stop);
        const int last = !records && !compares;
        const double to = compares ? middle : stop;
        const int how = to > t ? advance(self, part, t, to) : STEPPED;
        const double least = SHORTEST * (system->stop - system->start);
        const int ended = how == PART_ENDED && end - part->reached < least;
        const int waits = how == AT_EVENT && same_time(system, part->reached, end);
        if (last && (ended || waits)) return STEPPED;
        if (how != STEPPED) return how;
        t = to;
        if (last) return STEPPED;
        const int differs = part->order < MOST_ORDER; /* from the cubics, at the end of its step */
        if (differs && set_to_cubics(self, part, t - begin)) return PART_FAILED;
        if (!compares && part_record(&self->fmu, part, row++)) return PART_FAILED;
        if (middle < t || same_time(system, middle, t)) middle = INFINITY;
        if (system->method >= EXTRAPOLATED && compare_with_cubics(self, part, t - begin))
            return PART_FAILED;
    }
}

/* Inputs of a part that parts drive which have stepped already: their values there. */
static inline int take_new_outputs(Coupling *self, long long p) {
    System *system = self->system;
    const Part *part = system->parts + p;
    if (get_outputs(self)) return PART_FAILED;
    for (long long k = part->first_input; k < part->first_input + part->inputs; ++k) {
        const Part *source = system->parts;
        while (system->source[k] >= source->first_output + source->outputs) ++source;
        if (source->turn >= part->turn || system->held[k]) continue;
        self->next.u[k] = driven(self, k);
        system->input = k;
        if (!isfinite(self->next.u[k])) return INPUT_NOT_FINITE;
    }
    return STEPPED;
}

/* A part that steps at the same time as others, with room of its own for what that writes. */
typedef struct {
    Coupling own;
    double *part_u, *given;
    long long part, steps; /* taken before */
    int pass, recording, how;
} Stepper;

/* Step a part; from the second pass on only if it rolls back. */
static inline int step_again(Coupling *self, Part *part, int pass, int recording) {
    if (pass > 0 && !part->rolls_back) return STEPPED;
    if (pass > 0 && part_restore(&self->fmu, part)) return PART_FAILED;
    return step_part(self, part, recording || !part->rolls_back);
}

static inline void step_member(void *member) {
    Stepper *self = member;
    Part *part = self->own.system->parts + self->part;
    self->steps = part->steps;
    self->how = step_again(&self->own, part, self->pass, self->recording);
}

/* The part whose turn it is; in their declared order only where the result depends on it. */
static inline long long part_at(const System *system, long long turn) {
    if (system->method != GAUSS_SEIDEL) return turn;
    long long p = 0;
    while (system->parts[p].turn != turn) ++p;
    return p;
}

/* Step all parts at the same time; the answer is that of one after the other. */
static inline int step_together(Coupling *self, int pass, int recording) {
    System *system = self->system;
    Stepper *steppers = (Stepper *)self->crew.members;
    for (long long turn = 0; turn < system->n_parts; ++turn) {
        Stepper *one = steppers + turn;
        one->own = *self;
        one->own.part_u = one->part_u;
        one->own.given = one->given;
        one->own.fmu.called = NULL; /* at the same time there is more than one */
        one->part = part_at(system, turn);
        one->pass = pass;
        one->recording = recording;
    }
    if (system->called) *system->called = -1;
    crew_work(&self->crew);
    int how = STEPPED;
    for (long long turn = 0; turn < system->n_parts; ++turn) {
        const Stepper *one = steppers + turn;
        if (how != STEPPED) { /* it would not have stepped */
            system->parts[one->part].steps = one->steps;
            continue;
        }
        how = one->how;
        self->fmu = one->own.fmu;
        self->fmu.called = system->called;
        if (!(one->own.mismatch <= self->mismatch)) self->mismatch = one->own.mismatch;
        system->part = one->part;
    }
    return how;
}

/* Step all parts; from the second pass on those that roll back. */
static inline int step_parts(Coupling *self, int pass, int recording) {
    System *system = self->system;
    if (self->crew.count) return step_together(self, pass, recording);
    for (long long turn = 0; turn < system->n_parts; ++turn) {
        const long long p = system->part = part_at(system, turn);
        int how = system->method == GAUSS_SEIDEL ? take_new_outputs(self, p) : STEPPED;
        if (how == STEPPED) how = step_again(self, system->parts + p, pass, recording);
        if (how != STEPPED) return how;
    }
    return STEPPED;
}

enum { ACCEPTED, REJECTED, EVENT_WITHIN, BROKEN }; /* a macro step */

static inline int may_be_shortened(const Coupling *self) {
    return self->all_roll_back && !self->system->macro_step;
}

/* What a part that did not make its step means for the macro step. */
static inline int after_failed_step(Coupling *self, int how) {
    System *system = self->system;
    const double reached = system->parts[system->part].reached;
    self->ends = how == PART_ENDED;
    /* at the start of a step that may be shorter, a part may not tell how far it comes */
    const int is_known = !may_be_shortened(self) || !same_time(system, reached, self->now.t);
    if (how == AT_EVENT || (self->ends && self->ends_at_end && is_known)) {
        self->event = reached;
        return EVENT_WITHIN;
    }
    self->reason = how == PART_ENDED         ? ENDED_BY_FMU
                   : how == INPUT_NOT_FINITE ? NOT_A_NUMBER
                                             : CALL_FAILED;
    if ((how == NOT_STEPPED || self->ends) && may_be_shortened(self)) return REJECTED;
    system->how = self->reason;
    return BROKEN;
}

static inline int settled_next(Coupling *self) {
    System *system = self->system;
    const int how = settle(self, &self->next);
    if (how == DONE) return ACCEPTED;
    self->reason = how;
    if (how != CALL_FAILED && may_be_shortened(self)) return REJECTED;
    system->how = how;
    return BROKEN;
}

/* Whether differences that iterations do not make smaller are those of parts that round their
 * results: far below the error that is allowed, or all that there is where the step is given. */
static inline int is_small_enough(const Coupling *self, double left) {
    return may_be_shortened(self) ? left <= self->system->tolerance / 10 : left < 1;
}

/* The input whose given and found value or rate differ most. */
static inline long long worst_input(const Coupling *self, const double *given) {
    const long long m = self->system->inputs;
    long long worst = 0;
    for (long long i = 1; i < 2 * m; ++i)
        if (fabs(self->found[i] - given[i]) > fabs(self->found[worst] - given[worst])) worst = i;
    return worst % m;
}

/* Take the held inputs out of what has been found, so that only others iterate; tells whether one
 * has changed within the macro step. */
static inline int leave_out_held(Coupling *self, const double *w) {
    const System *system = self->system;
    int changed = 0;
    for (long long k = 0; k < system->inputs; ++k) {
        if (!system->held[k]) continue;
        changed |= self->next.u[k] != self->now.u[k];
        self->found[k] = w[k];
    }
    return changed;
}

/* The middle of a step without a past, which no prediction of order 4 judges. Steps that are as
 * short as rounding have none. */
static inline double place_to_compare(const Coupling *self) {
    const System *system = self->system;
    const double begin = self->now.t, end = self->next.t, middle = begin + (end - begin) / 2;
    if (self->known || !may_be_shortened(self) || system->quantum > 0) return INFINITY;
    const int exists = !same_time(system, begin, middle) && !same_time(system, middle, end);
    return exists ? middle : INFINITY;
}

/* Whether an input leaves its rest, which iterations do not follow yet, however little it moves. */
static inline int any_begins(const Coupling *self, const double *given) {
    const long long m = self->system->inputs;
    for (long long i = 0; i < 2 * m; ++i) {
        const long long k = i % m;
        if (self->now.r[k] != 0 || self->system->held[k]) continue;
        const double rest = i < m ? self->now.u[k] / size_of(self->system, k, self->now.u[k]) : 0;
        const double found = self->found[i], off = fabs(found - given[i]);
        if (off > fabs(found - rest) / 10 && off > 8 * DBL_EPSILON * fabs(found)) return 1;
    }
    return 0;
}

/* One macro step to `next.t`; `iterates`: until inputs and outputs at its end agree, or their
 * difference gets no smaller: then the best of all counts. `error` is the estimate of the
 * interface's error within, in scales. */
static inline int macro_step(Coupling *self, int iterates, double *error) {
    System *system = self->system;
    const long long m = system->inputs, n = 2 * m;
    /* one that ends at an event settles fully, so that no part falls back behind its crossing */
    const double share = isfinite(self->event)    ? 0
                         : system->macro_step > 0 ? AGREED_IN_GIVEN_STEPS
                                                  : AGREED;
    const int records = is_before(system, system->rows, self->next.t);
    if (!has_near_past(self)) self->known = 0;
    self->middle = iterates ? place_to_compare(self) : INFINITY;
    if (system->method >= EXTRAPOLATED)
        predict(self, 2, &self->next);
    else
        memcpy(self->next.u, self->now.u, (size_t)m * sizeof *self->next.u);
    double *predicted = self->found + n, *w = self->w;
    as_vector(self, &self->next, predicted);
    if (iterates) predict(self, MOST_POINTS, &self->next);
    as_vector(self, &self->next, w);
    double first = 0, best = INFINITY;
    self->ends = 0;
    int agreed = !iterates, idle = 0, final = 0;
    for (int pass = 0; pass <= MOST_ITERATIONS; ++pass) {
        ++system->iterations;
        const int recording = records && (agreed || final || pass >= self->agreed_at);
        self->mismatch = 0;
        const int how = step_parts(self, pass, recording);
        if (how == NOT_STEPPED && isfinite(best) && !final && !may_be_shortened(self) &&
            is_discarded(&self->fmu)) {
            memcpy(w, self->best, (size_t)n * sizeof *w); /* the last one led astray */
            from_vector(self, w, &self->next);
            final = 1;
            continue;
        }
        if (how != STEPPED) return after_failed_step(self, how);
        const int settled = settled_next(self);
        if (settled != ACCEPTED) return settled;
        as_vector(self, &self->next, self->found);
        self->switched = leave_out_held(self, w);
        if (agreed || final) break;
        for (long long i = 0; i < n; ++i) self->change[i] = self->found[i] - w[i];
        const double left = largest(n, self->change, NULL);
        const double correction = largest(n, self->found, predicted);
        if (pass == 0) first = left;
        self->reason = isfinite(left) ? STEP_VANISHED : NOT_A_NUMBER;
        const int diverges = !isfinite(left) || (may_be_shortened(self) && left > DIVERGED * first);
        if (diverges && (may_be_shortened(self) || pass == 0)) return REJECTED;
        double allowed = share * correction;
        if (isfinite(self->middle)) allowed = fmin(allowed, system->tolerance / 10);
        agreed = left <= fmax(allowed, ROUNDED * self->most);
        if (self->looks && any_begins(self, w)) agreed = 0;
        if (agreed) self->agreed_at = pass;
        if (agreed && (recording || !records)) break;
        idle = left < best ? 0 : idle + 1;
        if (left < best) memcpy(self->best, w, (size_t)n * sizeof *w);
        best = fmin(left, best);
        final = !agreed && (diverges || idle == MOST_IDLE || pass + 1 == MOST_ITERATIONS);
        if (agreed)
            memcpy(w, self->found, (size_t)n * sizeof *w);
        else if (final)
            memcpy(w, self->best, (size_t)n * sizeof *w);
        else
            accelerate(&self->iteration, w, self->change, pass == 0);
        from_vector(self, w, &self->next);
    }
    if (!agreed && !is_small_enough(self, best)) {
        system->input = worst_input(self, w);
        self->reason = may_be_shortened(self) ? STEP_VANISHED : UNSETTLED;
        return REJECTED;
    }
    if (!agreed && !may_be_shortened(self) && best > system->tolerance) {
        ++system->unsettled;
        system->noted = worst_input(self, w);
    }
    const double h = self->next.t - self->now.t;
    const double before = self->known ? self->now.t - self->past[0].t : h;
    *error = largest(m, self->found, predicted) * pow(h / (h + before), 2) / 16;
    if (isfinite(self->middle)) *error = 0; /* of a line; the middle shows that of the cubics */
    *error = self->switched ? INFINITY : fmax(*error, self->mismatch);
    if (*error > system->tolerance) system->input = worst_input(self, predicted);
    return ACCEPTED;
}

#endif
