/* The interface of a coupled system at a communication point: inputs equal the outputs that drive
 * them, also through loops of direct feedthrough, and so do their rates.
 *
 * Source  Kuebler, Schiehlen, Multibody Syst. Dyn. 4, 2000 (loops).
 */
#ifndef INTERFACE_H
#define INTERFACE_H

#include "crew.h"
#include "fixed_point.h"
#include "part.h"
#include "run.h"

enum { JACOBI, GAUSS_SEIDEL, EXTRAPOLATED, ITERATED };       /* as `Method` in cosim/coupling */
enum { LOOP_UNSOLVED = NOT_A_NUMBER + 1, UNSETTLED, NOISY }; /* how a run ended, after run.h's */
enum { MOST_SOLUTIONS = 30, PAST = 3 };

static const double ROUNDED = 1e-13; /* difference of interfaces that agree, of `most` */

typedef struct {
    Part *parts;
    long long n_parts, inputs, outputs; /* connected ones of all parts, part after part */
    const long long *source;            /* of each input: the output that drives it */
    const double *factor, *offset;      /* input = factor output + offset */
    const long long *held;  /* of each input: whether it is constant between communication points */
    const long long *feeds; /* (outputs, inputs): whether there is feedthrough */
    double *u;              /* inputs at the start: a guess, then their values */
    double *scale;          /* sizes of the inputs */
    const long long *grows; /* whether a scale is the largest value so far */
    const double *times;    /* of outputs */
    long long points;
    double start, stop;
    double goal;       /* where the present call ends */
    long long ends;    /* whether the run ends at `stop`; otherwise that tells its scale */
    double macro_step; /* 0: chosen by the error */
    double tolerance;  /* of the inputs, in their scales; with given steps, what parts round */
    double quantum;    /* macro steps are multiples of it; 0: any */
    double refinement; /* the longest and the first macro steps, of the usual ones */
    long long method;
    long long threads; /* whether parts step at the same time, where their order does not matter */
    double *lowest, *highest; /* inputs in the first half of the run, then in all of it */
    bool *at_jumps;    /* rows within steps that no shortening makes accurate: either side counts */
    long long *called; /* the part that is being called, for who looks on; NULL */
    Texts *texts;      /* NULL before the start is settled, and after the run */
    /* answers */
    long long how, rows, macro_steps, rejected, iterations, unsettled, forced, part, input, status;
    const char *function;
    double time, mismatch;          /* of inputs and outputs where steps are given, the largest */
    double interface_error, coarse; /* estimates for given steps: with a past; without any */
    double noise; /* of an input, in its scale, where it keeps steps from getting longer */
    long long jumps, noted; /* given macro steps as which an input jumps; the input of a note */
    void *coupling;         /* the `Coupling` of a run that is open */
} System;

/* Whether two times of a run are the same but for rounding. */
static inline int same_time(const System *system, double a, double b) {
    const double later = fmin(fmax(fabs(a), fabs(b)), DBL_MAX);
    const double rounding = rounding_of_times(system->stop - system->start, later);
    return fabs(a - b) < rounding || at_one_time(a, b, system->start, 1e-12);
}

/* The interface at a communication point: inputs and their rates. */
typedef struct {
    double t, *u, *r;
} Interface;

/* Attempts of macro steps, in windows of equal number. */
typedef struct {
    long long made, rejected;
    double begin; /* its time */
} Attempts;

typedef struct {
    System *system;
    Fmu fmu;
    int feedthrough, all_roll_back;
    int ends_at_end;    /* whether a macro step ends where a part ends the run */
    int ends_at_events; /* whether macro steps end at events of parts */
    double event;       /* the time of one that ends the next macro step */
    double missed;      /* the time of one to which a macro step was rejected */
    int inevitable;     /* whether a shorter one reached it as well */
    int standstills;    /* events without a step between */
    int unreached;      /* macro steps in succession that an event cut short */
    int ends;           /* whether a part ends the run within the macro step */
    int reason;         /* why a macro step was rejected, as the end of a run */
    int switched;       /* whether a held input has changed within the macro step */
    int looks;          /* whether the macro step only looks whether an event is where it begins */
    long long looked;   /* whether one has, since the past was forgotten */
    int powers;         /* whether one has found that, and no step has been made since */
    int refused; /* whether a part did not take the inputs that it asked for within its step */
    Interface now, next, past[PAST]; /* the newest of the past first */
    long long known;                 /* points of the past */
    long long given_steps;           /* of a given length, completed */
    double h;                        /* about the length of the next one that is chosen */
    Attempts window;
    long long slow;     /* whether the last window hardly came on */
    long long rateless; /* whether rates that follow from values are not known here */
    int guessed;        /* whether a rate of the last settled interface follows from values */
    double middle; /* time within the step where outputs are compared with cubics; or INFINITY */
    double most;   /* the largest input so far, in scales */
    long long agreed_at; /* the pass in which the last step's interface agreed */
    double mismatch;     /* of outputs and inputs, at output times within the step */
    double *y, *gain, *matrix, *column, *part_u, *given, *change, *w, *found, *best, *jumps;
    FixedPoint iteration;
    Crew crew; /* of `Stepper`s; none if its count is 0 */
    double *memory, *crew_numbers;
} Coupling;

static inline int give_up(Coupling *self, long long part) {
    self->system->part = part;
    return 1;
}

/* Whether the call that failed had no answer now, as while something slides; then go on. */
static inline int is_discarded(Fmu *fmu) {
    if (fmu->status != DISCARD) return 0;
    fmu->function = NULL;
    return 1;
}

static inline int all_finite(long long n, const double *values) {
    for (long long i = 0; i < n; ++i)
        if (!isfinite(values[i])) return 0;
    return 1;
}

static inline int set_inputs(Coupling *self, const double *u) {
    const System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p) {
        const Part *part = system->parts + p;
        if (part_set(&self->fmu, part, u + part->first_input)) return give_up(self, p);
    }
    return 0;
}

static inline int get_outputs(Coupling *self) {
    for (long long p = 0; p < self->system->n_parts; ++p) {
        const Part *part = self->system->parts + p;
        if (part_get(&self->fmu, part, self->y + part->first_output)) return give_up(self, p);
    }
    return 0;
}

/* An input as the outputs want it. */
static inline double driven(const Coupling *self, long long k) {
    const System *system = self->system;
    return system->factor[k] * self->y[system->source[k]] + system->offset[k];
}

/* Derivatives of driven inputs by inputs at a communication point, (inputs, inputs). */
static inline int find_gain(Coupling *self, const double *u) {
    const System *system = self->system;
    const long long m = system->inputs;
    memset(self->gain, 0, (size_t)(m * m) * sizeof *self->gain);
    for (long long p = 0; p < system->n_parts; ++p) {
        const Part *part = system->parts + p;
        const long long output = part->first_output;
        for (long long i = 0; i < part->inputs; ++i) {
            const long long input = part->first_input + i;
            int direct = 0;
            if (system->held[input]) continue; /* it has no derivatives, nor what drives it */
            for (long long k = 0; k < part->outputs; ++k)
                direct |= system->feeds[(output + k) * m + input] != 0;
            if (!direct) continue;
            const int known = part->directional && !part_column(&self->fmu, part, i, self->column);
            if (part->directional && !known && !is_discarded(&self->fmu)) return give_up(self, p);
            if (!known || !all_finite(part->outputs, self->column)) {
                const double step = 1e-6 * fmax(system->scale[input], fabs(u[input]));
                memcpy(self->part_u, u + input - i, (size_t)part->inputs * sizeof *u);
                self->part_u[i] += step;
                if (part_set(&self->fmu, part, self->part_u) ||
                    part_get(&self->fmu, part, self->column) ||
                    part_set(&self->fmu, part, u + input - i))
                    return give_up(self, p);
                for (long long k = 0; k < part->outputs; ++k)
                    self->column[k] = (self->column[k] - self->y[output + k]) / step;
            }
            for (long long k = 0; k < m; ++k)
                if (!system->held[k] && system->source[k] >= output &&
                    system->source[k] < output + part->outputs)
                    self->gain[k * m + input] =
                        system->factor[k] * self->column[system->source[k] - output];
        }
    }
    return 0;
}

/* Solve (1 - gain) x = b; b becomes x. */
static inline int through_loops(Coupling *self, double *b) {
    const long long m = self->system->inputs;
    for (long long i = 0; i < m * m; ++i) self->matrix[i] = -self->gain[i];
    for (long long i = 0; i < m; ++i) self->matrix[i * m + i] += 1;
    const long long determined = solve_dense(m, self->matrix, b);
    if (determined) self->system->input = determined - 1;
    return determined != 0;
}

static inline double size_of(const System *system, long long i, double u) {
    return system->scale[i] + fabs(u);
}

/* Inputs that equal the outputs that drive them; `u` is a guess. Returns how the run goes on. */
static inline int settle_values(Coupling *self, double *u) {
    System *system = self->system;
    const long long m = system->inputs;
    double last = INFINITY;
    if (!self->feedthrough) { /* no output feels an input at once */
        if (get_outputs(self)) return CALL_FAILED;
        for (long long k = 0; k < m; ++k) {
            if (!isfinite(u[system->input = k] = driven(self, k))) return NOT_A_NUMBER;
            self->most = fmax(self->most, fabs(u[k]) / size_of(system, k, u[k]));
        }
        return set_inputs(self, u) ? CALL_FAILED : DONE;
    }
    for (int n = 0; n < MOST_SOLUTIONS; ++n) {
        double worst = 0;
        if (set_inputs(self, u) || get_outputs(self)) return CALL_FAILED;
        for (long long k = 0; k < m; ++k) {
            self->change[k] = driven(self, k) - u[k];
            const double size = size_of(system, k, u[k]), off = fabs(self->change[k]) / size;
            if (!(off <= worst)) {
                worst = off;
                system->input = k;
            }
            if (!isfinite(off)) return NOT_A_NUMBER;
            self->most = fmax(self->most, fabs(u[k]) / size);
        }
        if (worst <= ROUNDED * self->most || (worst >= last / 2 && last < 1e-10)) return DONE;
        if (n % 4 == 0 && find_gain(self, u)) return CALL_FAILED;
        if (through_loops(self, self->change)) return LOOP_UNSOLVED;
        for (long long k = 0; k < m; ++k) u[k] += self->change[k];
        last = worst;
    }
    return LOOP_UNSOLVED;
}

/* Derivative at a point of the polynomial through it, the present point and those of the past. */
static inline double rate_of_values(const Coupling *self, const Interface *at, long long k) {
    const Interface *points[PAST] = {&self->now};
    long long n = at == &self->now ? 0 : 1;
    for (long long i = 0; i < self->known && n < PAST; ++i) points[n++] = &self->past[i];
    double sum = 0;
    for (long long i = 0; i < n; ++i) { /* of the Lagrange polynomial of each other point */
        double weight = 1 / (at->t - points[i]->t);
        for (long long j = 0; j < n; ++j)
            if (j != i) weight *= (at->t - points[j]->t) / (points[i]->t - points[j]->t);
        sum += weight * (at->u[k] - points[i]->u[k]);
    }
    return sum;
}

/* Rates of the inputs of a settled interface. */
static inline int settle_rates(Coupling *self, Interface *at) {
    System *system = self->system;
    if (self->feedthrough && find_gain(self, at->u)) return CALL_FAILED;
    self->guessed = 0;
    memset(self->change, 0, (size_t)system->inputs * sizeof *self->change);
    for (long long p = 0; p < system->n_parts; ++p) {
        const Part *part = system->parts + p;
        double *rates = self->y + part->first_output;
        const int has_rates = part->rates && !part->ends;
        if (has_rates && part->order && part_set_derivatives(&self->fmu, part, 1, self->change))
            return give_up(self, p), CALL_FAILED;
        const int known = has_rates && !part_rates(&self->fmu, part, rates);
        if (has_rates && !known && !is_discarded(&self->fmu)) return give_up(self, p), CALL_FAILED;
        for (long long i = 0; !known && i < part->outputs; ++i) rates[i] = NAN;
    }
    const long long m = system->inputs;
    for (long long k = 0; k < m; ++k) {
        const double last = at->r[k];
        at->r[k] = system->held[k] ? 0 : system->factor[k] * self->y[system->source[k]];
        if (isfinite(at->r[k])) continue;
        self->guessed = 1; /* by values, which hold what passes through loops; first by the past */
        at->r[k] = self->rateless && at == &self->now ? last : rate_of_values(self, at, k);
        memset(self->gain + k * m, 0, (size_t)m * sizeof *self->gain);
        if (self->rateless && at != &self->now && !self->looks) self->now.r[k] = at->r[k];
    }
    return self->feedthrough && through_loops(self, at->r) ? LOOP_UNSOLVED : DONE;
}

static inline int settle(Coupling *self, Interface *at) {
    const int how = settle_values(self, at->u);
    if (how != DONE) return how;
    return self->system->method >= EXTRAPOLATED ? settle_rates(self, at) : DONE;
}

/* The next event that ends a macro step: one that cut one short, or that a part has announced. */
static inline double next_event(const Coupling *self) {
    const System *system = self->system;
    double next = self->event;
    for (long long p = 0; p < system->n_parts; ++p) {
        const Part *part = system->parts + p;
        if (part->own_step > 0) return self->event;
        const int ahead = part->event_mode && !same_time(system, part->next_event, self->now.t);
        if (ahead && part->next_event > self->now.t) next = fmin(next, part->next_event);
    }
    return next;
}

/* The end of the next macro step, about `h` long. */
static inline double next_end(const Coupling *self, double h) {
    const System *system = self->system;
    if (system->quantum > 0) {
        const double taken = (self->now.t - system->start) / system->quantum;
        const double steps = fmax(floor(1.01 * h / system->quantum), 1);
        const double end = system->start + (round(taken) + steps) * system->quantum;
        return end >= system->goal || same_time(system, end, system->goal) ? system->goal : end;
    }
    const double goal = fmin(system->goal, next_event(self));
    return self->now.t + 1.01 * h >= goal ? goal : self->now.t + h;
}

#endif
