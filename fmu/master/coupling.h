/* Co-simulation of parts whose outputs drive inputs of other parts, in macro steps.
 *
 * At a communication point the interface is settled, see interface.h. A macro step whose error is
 * too large is taken back. With the iterated method, one ends where an event of a part does; what
 * happens there happens in all parts before the next step begins. A part that ends the run ends
 * that of the system: in event mode at this time, else at the last communication point before it.
 */
#ifndef COUPLING_H
#define COUPLING_H

#include "departures.h"
#include "noise.h"

enum { MOST_FORCED = 1000 };

static const double SAFE = 0.8, SHORTER = 0.2; /* of macro steps */
static const double LONGEST = 0.1;             /* macro step, of the span */
static const double AFTER_START = 5; /* times the one before, where no prediction is needed */
static const double CRAWLS = 1e-10;  /* length of steps between events, of the given one */
static const double MOST_BY_RATE = 4.0 / 27; /* of s (1 - s)^2, which a rate adds to a cubic */
static const double OF_PARTS = 0.01; /* tolerance of the parts' solvers, of the coupling's */

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
        const int looks = self->known == 0 && self->all_roll_back && self->ends_at_events;
        const int here = looks && !self->looked ? pass_departures(self) : DONE;
        if (here != DONE) return here;
        self->next.t = next_end(self, self->h);
        const double length = self->next.t - self->now.t;
        if (save_all(self)) return CALL_FAILED;
        if (self->slow && is_noisy(self, length, OF_PARTS * system->tolerance)) return NOISY;
        const int how = macro_step(self, iterates(self), &error);
        if (how == BROKEN) return (int)system->how;
        if (how == REJECTED && !self->all_roll_back) return self->reason;
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
    long long crawled = 0, switching = -1; /* steps in succession; the part whose events end them */
    while (!is_at_goal(self)) {
        if (halted) return INTERRUPTED;
        double end = system->start + (double)(self->given_steps + 1) * system->macro_step;
        if (same_time(system, end, system->stop)) end = system->stop;
        const int reaches = end <= system->goal || same_time(system, end, system->goal);
        self->next.t = fmin(reaches ? end : system->goal, next_event(self));
        const int goes_back = self->ends_at_end || system->method >= EXTRAPOLATED;
        if (goes_back && save_all(self)) return CALL_FAILED;
        double error = 0;
        const int how = given_step(self, &error);
        if (how == BROKEN) return (int)system->how;
        if (how == REJECTED) return self->reason;
        if (how == EVENT_WITHIN) {
            switching = system->part;
            const int passed = back_to_event(self);
            if (passed != DONE) return passed;
            continue;
        }
        const int crawls = self->next.t - self->now.t < CRAWLS * system->macro_step;
        crawled = crawls ? crawled + 1 : 0;
        if (crawled > MOST_UPDATES) return give_up(self, switching), STUCK;
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
