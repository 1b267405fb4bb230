/* Co-simulation of parts whose outputs drive inputs of other parts, in macro steps.
 *
 * At a communication point the interface is settled, see interface.h. A macro step whose error is
 * too large is taken back. With the iterated method, one ends where an event of a part does; what
 * happens there happens in all parts before the next step begins. A part that ends the run ends
 * that of the system: in event mode at this time, else at the last communication point before it.
 */
#ifndef COUPLING_H
#define COUPLING_H

#include "macro_step.h"
#include "noise.h"

enum { MOST_FORCED = 1000 };

static const double SAFE = 0.8, SHORTER = 0.2;                    /* of macro steps */
static const double SHORTEST = 1e-9, FIRST = 1e-3, LONGEST = 0.1; /* macro steps, of the span */
static const double AFTER_START = 5; /* times the one before, where no prediction is needed */
static const double MOST_BY_RATE = 4.0 / 27; /* of s (1 - s)^2, which a rate adds to a cubic */
static const double OF_PARTS = 0.01; /* tolerance of the parts' solvers, of the coupling's */

/* Whether all that the parts have recorded in a row are numbers. Returns how the run goes on. */
static inline int check_row(Coupling *self, long long row) {
    const System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p) {
        const Recording *recording = system->parts[p].recording;
        if (all_finite(recording->width, recording->rows + row * recording->width)) continue;
        self->system->input = -1; /* the row tells which variable it is */
        return give_up(self, p), NOT_A_NUMBER;
    }
    return DONE;
}

/* Returns how the run goes on. */
static inline int record_all(Coupling *self, long long row) {
    System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p)
        if (part_record(&self->fmu, system->parts + p, row)) return give_up(self, p), CALL_FAILED;
    return check_row(self, row);
}

/* Record the present point as the next row. */
static inline int record_next(Coupling *self) {
    const int how = record_all(self, self->system->rows);
    if (how == DONE) ++self->system->rows;
    return how;
}

static inline int save_all(Coupling *self) {
    System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p)
        if (part_save(&self->fmu, system->parts + p)) return give_up(self, p);
    return 0;
}

static inline int restore_all_but(Coupling *self, const Part *one) {
    System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p)
        if (system->parts + p != one && part_restore(&self->fmu, system->parts + p))
            return give_up(self, p);
    return 0;
}

/* A part ends the run at the present point, which becomes the last row. */
static inline int end_here(Coupling *self) {
    System *system = self->system;
    const long long part = system->part;
    if (system->rows == system->points ||
        (system->rows > 0 && same_time(system, system->times[system->rows - 1], self->now.t)))
        --system->rows;
    const int how = record_next(self);
    if (how != DONE) return how;
    system->part = part;
    return ENDED_BY_FMU;
}

/* What has been no longer tells what will be. */
static inline void forget_past(Coupling *self) {
    self->known = 0;
    self->rateless = 1;
}

/* No event is known to end the next macro step. */
static inline void forget_event(Coupling *self) {
    self->event = self->missed = INFINITY;
    self->standstills = self->unreached = self->inevitable = 0;
}

/* All that happens at the present point, in event mode of the parts that have one, until no input
 * changes by it. */
static inline int let_happen(Coupling *self) {
    System *system = self->system;
    const size_t size = (size_t)system->inputs * sizeof *self->w;
    for (int n = 0, changed = 1; changed; ++n) {
        if (n == MOST_UPDATES) return STUCK;
        for (long long p = 0; p < system->n_parts; ++p) {
            if (!system->parts[p].event_mode) continue;
            const int how = part_update(&self->fmu, system->parts + p);
            if (how != STEPPED) give_up(self, p);
            if (how != STEPPED) return how == PART_ENDED ? end_here(self) : CALL_FAILED;
        }
        memcpy(self->w, self->now.u, size);
        const int how = settle_values(self, self->now.u);
        if (how != DONE) return how;
        changed = memcmp(self->w, self->now.u, size) != 0;
    }
    for (long long p = 0; p < system->n_parts; ++p)
        if (system->parts[p].event_mode && part_enter_step_mode(&self->fmu, system->parts + p))
            return give_up(self, p), CALL_FAILED;
    forget_past(self);
    return settle(self, &self->now);
}

static inline int enter_event_modes(Coupling *self) {
    System *system = self->system;
    for (long long p = 0; p < system->n_parts; ++p)
        if (system->parts[p].event_mode && part_enter_event_mode(&self->fmu, system->parts + p))
            return give_up(self, p), CALL_FAILED;
    return DONE;
}

/* Whether an input of a part has changed that is set in event mode only. */
static inline int has_switched(const Coupling *self, const Part *part) {
    return self->switched && part->event_mode && part->steady->width < part->inputs;
}

/* Let parts wait for an event of their own at the present point, where others wait: a step on finds
 * it, and what happens in others first would undo its cause. */
static inline int wait_together(Coupling *self) {
    System *system = self->system;
    self->next.t = fmin(self->now.t + FIRST * (system->stop - system->start), system->stop);
    if (!self->ends_at_events || same_time(system, self->next.t, self->now.t)) return 0;
    self->middle = INFINITY;
    predict(self, 2, &self->next);
    for (long long p = 0; p < system->n_parts; ++p) {
        Part *part = system->parts + p;
        const long long steps = part->steps;
        if (!part->event_mode || part->waits || !part->rolls_back || part->own_step > 0) continue;
        if (part_save(&self->fmu, part)) return give_up(self, p);
        const int how = step_part(self, part, 0);
        part->steps = steps;
        if (how == AT_EVENT && same_time(system, part->reached, self->now.t)) continue;
        if (how == NOT_STEPPED && !is_discarded(&self->fmu)) return give_up(self, p);
        if (how == PART_FAILED || part_restore(&self->fmu, part)) return give_up(self, p);
    }
    return 0;
}

/* Let all happen that is due. What changes neither inputs nor their rates, such as a condition that
 * is no longer true, leaves the past as it is. */
static inline int let_due_happen(Coupling *self) {
    const size_t size = (size_t)self->system->inputs * sizeof *self->now.u;
    const long long known = self->known;
    copy(self, &self->next, &self->now);
    /* events see the values that relations of time in other parts have now */
    int how = settle_values(self, self->now.u);
    if (how == DONE) how = let_happen(self);
    const int same = memcmp(self->now.u, self->next.u, size) == 0 &&
                     memcmp(self->now.r, self->next.r, size) == 0;
    if (how != DONE || !known || !same || self->guessed) return how;
    self->known = known;
    self->rateless = 0;
    return DONE;
}

/* What happens at the present point, if a part waits for it; at the last one, no step follows that
 * would find it. */
static inline int pass_events(Coupling *self) {
    System *system = self->system;
    const int last = system->ends && same_time(system, self->now.t, system->stop);
    int any = 0, waits = 0;
    for (long long p = 0; p < system->n_parts; ++p) {
        waits |= system->parts[p].waits != 0;
        any |= (last && system->parts[p].event_mode) || has_switched(self, system->parts + p);
    }
    if (!any && !waits) return DONE;
    if (waits && wait_together(self)) return CALL_FAILED;
    return enter_event_modes(self) == DONE ? let_due_happen(self) : CALL_FAILED;
}

/* Go back to the start of a macro step within which there is an event; let it happen if it is there
 * already. */
static inline int back_to_event(Coupling *self) {
    const int here = same_time(self->system, self->event, self->now.t);
    self->inevitable |= self->event > self->next.t && self->event == self->missed;
    if (++self->unreached > MOST_UPDATES) return STUCK;
    if (restore_all_but(self, here ? self->system->parts + self->system->part : NULL))
        return CALL_FAILED;
    if (!here) return DONE;
    self->event = INFINITY;
    if (++self->standstills > MOST_UPDATES) return STUCK;
    const int how = pass_events(self);
    if (how != DONE) return how;
    const System *system = self->system;
    const int recorded =
        system->rows > 0 && same_time(system, system->times[system->rows - 1], self->now.t);
    return recorded ? record_all(self, system->rows - 1) : DONE;
}

/* Extend the ranges of the inputs by the present point. */
static inline void extend_ranges(const Coupling *self) {
    const System *system = self->system;
    const long long m = system->inputs;
    const double middle = 0.5 * (system->start + system->stop);
    const int late = self->now.t > middle && !same_time(system, self->now.t, middle);
    for (long long i = late ? m : 0; i < 2 * m; ++i) {
        system->lowest[i] = fmin(system->lowest[i], self->now.u[i % m]);
        system->highest[i] = fmax(system->highest[i], self->now.u[i % m]);
    }
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
    self->rateless = 0;
    if (self->switched) forget_past(self);
    system->time = self->now.t;
    for (; is_before(system, system->rows, self->now.t); ++system->rows) { /* within the step */
        const int how = check_row(self, system->rows);
        if (how != DONE) return how;
    }
    int how = pass_events(self);
    if (how == DONE && system->rows < system->points &&
        same_time(system, system->times[system->rows], self->now.t))
        how = record_next(self);
    if (how != DONE) return how;
    for (long long k = 0; k < system->inputs; ++k)
        if (system->grows[k]) system->scale[k] = fmax(system->scale[k], fabs(self->now.u[k]));
    extend_ranges(self);
    ++system->macro_steps;
    forget_event(self);
    return DONE;
}

/* Whether the next macro step is repeated until its interface agrees: to an event, and where there
 * is too little to extrapolate from, as after one, every step is, if it can be. */
static inline int iterates(const Coupling *self) {
    if (self->system->method != EXTRAPOLATED) return self->system->method == ITERATED;
    return self->all_roll_back && (isfinite(self->event) || !has_near_past(self));
}

/* How a run ends whose macro steps become too short, for a reason. */
static inline int vanished(Coupling *self, int reason) {
    const System *system = self->system;
    const double length = FIRST * (system->stop - system->start);
    const double allowed = OF_PARTS * system->tolerance;
    return reason == STEP_VANISHED && is_noisy(self, length, allowed) ? NOISY : reason;
}

/* The length of a macro step that is chosen without a past. */
static inline double first_length(const Coupling *self) {
    const System *system = self->system;
    const double first = FIRST * (system->stop - system->start);
    const double refined = first * system->refinement;
    return self->all_roll_back ? refined : fmin(refined, sqrt(system->tolerance) * first);
}

/* The longest macro step after one of a length: where each step is as long as it may be, those of a
 * refined run are half as long at the same time, not the same ones after a shorter first step. */
static inline double longer(const Coupling *self, double length) {
    const double refinement = self->system->refinement;
    const double usual = (LONGER - 1) * fmax(refinement, 0.5);
    const double checked = isfinite(self->middle) ? (AFTER_START - 1) * refinement : 0;
    return length * (1 + fmax(usual, checked));
}

static inline int is_at_goal(const Coupling *self) {
    const System *system = self->system;
    return system->time >= system->goal || same_time(system, system->time, system->goal);
}

static inline int run_adaptive(Coupling *self) {
    System *system = self->system;
    const double span = system->stop - system->start;
    const double least = fmax(SHORTEST * span, 1.01 * system->quantum);
    const double longest = LONGEST * system->refinement * span;
    while (!is_at_goal(self)) {
        if (halted) return INTERRUPTED;
        double error = 0;
        self->next.t = next_end(self, self->h);
        const double length = self->next.t - self->now.t;
        if (save_all(self)) return CALL_FAILED;
        if (self->slow && is_noisy(self, length, OF_PARTS * system->tolerance)) return NOISY;
        const int how = macro_step(self, iterates(self), &error);
        if (how == BROKEN) return (int)system->how;
        if (how == EVENT_WITHIN) {
            const int passed = back_to_event(self);
            if (passed != DONE) return passed;
            if (isfinite(self->event)) self->h = self->event - system->time;
            if (self->known == 0 && !isfinite(self->event)) self->h = first_length(self);
            continue;
        }
        const int shortest = length <= least || (self->inevitable && self->next.t == self->event);
        const int too_far = error > system->tolerance && self->all_roll_back;
        const double factor =
            how == REJECTED ? 0.25 : SAFE * pow(system->tolerance / fmax(error, 1e-300), 0.25);
        const int rejected = how == REJECTED || (too_far && !shortest);
        if (rejected && shortest && !self->ends) return vanished(self, self->reason);
        self->slow = hardly_advances(self, &self->window, rejected || error > system->tolerance);
        if (self->slow && self->window.rejected > WINDOW / 4) return vanished(self, STEP_VANISHED);
        if (rejected) {
            ++system->rejected;
            if (self->next.t == self->event) self->missed = self->event;
            const long long part = system->part;
            if (restore_all_but(self, NULL)) return CALL_FAILED;
            system->part = part;
            if (shortest) return end_here(self);
            self->h = length * fmin(fmax(factor, SHORTER), SAFE);
            continue;
        }
        if (too_far && !self->switched && ++system->forced > MOST_FORCED && !system->quantum)
            return vanished(self, STEP_VANISHED);
        const long long row = system->rows;
        const double most = longer(self, length);
        const int arrived = arrive(self);
        if (arrived != DONE) return arrived;
        for (long long r = row; too_far && r < system->rows; ++r) system->at_jumps[r] = true;
        double h = fmin(length * fmax(factor, SHORTER), most);
        if (self->known == 0) h = first_length(self); /* after an event, or a switch */
        self->h = fmin(fmax(h, SHORTEST * span), longest);
    }
    return DONE;
}

/* How far outputs have moved from what was predicted for the end of the last step. */
static inline double jump_of(const Coupling *self) {
    const long long m = self->system->inputs;
    return largest(m, self->found, self->found + 2 * m);
}

/* Whether an output has jumped in the last step, so that a cubic through both sides misleads: the
 * prediction was no better than none. */
static inline int jumped(Coupling *self) {
    const long long m = self->system->inputs;
    as_vector(self, &self->now, self->change);
    const double change = largest(m, self->found, self->change);
    return change > 0 && jump_of(self) >= change;
}

/* Estimate the error of the cubics within the last given step, unlike `mismatch`, which tells what
 * was seen of it at output times. A step without a past has only the order 2 of a straight line:
 * that counts where no step has more. */
static inline void estimate_error(Coupling *self, double error) {
    System *system = self->system;
    const long long m = system->inputs;
    const double *found = self->found;
    const double seen = fmax(self->mismatch, largest(m, found, self->w));
    const int tells = self->known > 0 && !self->switched;
    system->interface_error = fmax(system->interface_error, tells ? fmax(error, seen) : seen);
    if (tells) system->coarse = -1;
    if (!self->switched && system->coarse >= 0) system->coarse = fmax(system->coarse, error);
    as_vector(self, &self->now, self->change);
    const double moved = largest(m, found, self->change);
    if (!self->known) /* the mean of both rates tells what was to be expected */
        for (long long k = 0; k < m; ++k)
            self->change[k] += (self->change[m + k] + found[m + k]) / 2;
    const double jump = largest(m, found, self->known ? found + 2 * m : self->change);
    if (moved > 0 && jump >= moved) system->interface_error = fmax(system->interface_error, jump);
}

/* Find the inputs that jump as the last step begins, as a small heat capacity off its balance does:
 * the rate there moves their cubic further than they have moved, or by more than their size at
 * either end. */
static inline int find_jumps(Coupling *self, int accepted) {
    System *system = self->system;
    const long long m = system->inputs;
    int any = 0;
    as_vector(self, &self->now, self->change);
    for (long long k = 0; k < m; ++k) {
        const double value = fabs(self->found[k] - self->change[k]),
                     rate = fabs(self->found[m + k]);
        const double moved = accepted ? fmax(fmax(value, rate), system->tolerance) : 1;
        self->jumps[k] = MOST_BY_RATE * fabs(self->change[m + k]) > fmin(moved, fmax(value, 1));
        if (self->jumps[k] == 0) continue;
        any = 1;
        system->noted = k;
    }
    return any;
}

/* A macro step of a given length; it is repeated without what inputs do that jump as it begins. */
static inline int given_step(Coupling *self, double *error) {
    const int repeats = self->all_roll_back && iterates(self);
    memset(self->jumps, 0, (size_t)self->system->inputs * sizeof *self->jumps);
    const int how = macro_step(self, iterates(self), error);
    if (!repeats || how > REJECTED || !find_jumps(self, how == ACCEPTED)) return how;
    self->system->how = CALL_FAILED; /* of going back */
    return restore_all_but(self, NULL) ? BROKEN : macro_step(self, 1, error);
}

static inline int run_fixed(Coupling *self) {
    System *system = self->system;
    while (!is_at_goal(self)) {
        if (halted) return INTERRUPTED;
        double end = system->start + (double)(self->given_steps + 1) * system->macro_step;
        if (same_time(system, end, system->stop)) end = system->stop;
        const int reaches = end <= system->goal || same_time(system, end, system->goal);
        self->next.t = fmin(reaches ? end : system->goal, next_event(self));
        if (system->method >= EXTRAPOLATED && save_all(self)) return CALL_FAILED;
        double error = 0;
        const int how = given_step(self, &error);
        if (how == BROKEN) return (int)system->how;
        if (how == REJECTED) return self->reason;
        if (how == EVENT_WITHIN) {
            const int passed = back_to_event(self);
            if (passed != DONE) return passed;
            continue;
        }
        system->jumps += largest(system->inputs, self->jumps, NULL) > 0;
        const double given = largest(system->inputs, self->found, self->w);
        system->mismatch = fmax(system->mismatch, fmax(self->mismatch, given));
        if (system->method >= EXTRAPOLATED) estimate_error(self, error);
        const int jumps = jumped(self);
        if (jumps) system->mismatch = fmax(system->mismatch, jump_of(self));
        const int arrived = arrive(self);
        if (arrived != DONE) return arrived;
        if (jumps) forget_past(self);
        if (same_time(system, self->now.t, end)) ++self->given_steps;
    }
    return DONE;
}

/* Whether a part has announced an event for the present point, which a next step would find. */
static inline int is_due(const Coupling *self) {
    const System *system = self->system;
    int any = 0;
    for (long long p = 0; p < system->n_parts; ++p) {
        const Part *part = system->parts + p;
        any |= part->event_mode && same_time(system, part->next_event, self->now.t);
    }
    return any && self->ends_at_events && !(system->ends && self->now.t >= system->stop);
}

/* Let events happen that are announced for the present point: a step that they cut short finds
 * them. Any other step is taken back. */
static inline int pass_due_events(Coupling *self) {
    const System *system = self->system;
    while (is_due(self)) {
        double error = 0;
        self->next.t = self->now.t + (system->macro_step > 0 ? system->macro_step : self->h);
        if (save_all(self)) return CALL_FAILED;
        const int how = macro_step(self, iterates(self), &error);
        if (how != EVENT_WITHIN || !same_time(system, self->event, self->now.t)) {
            self->event = INFINITY;
            return restore_all_but(self, NULL) ? CALL_FAILED : DONE;
        }
        const int passed = back_to_event(self);
        if (passed != DONE) return passed;
    }
    forget_event(self);
    return DONE;
}

/* Goes on to the goal of the present call. */
static inline int go_on(Coupling *self) {
    const int how = self->system->macro_step > 0 ? run_fixed(self) : run_adaptive(self);
    return how == DONE ? pass_due_events(self) : how;
}

#endif
