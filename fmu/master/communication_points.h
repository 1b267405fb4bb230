/* Communication points: what is recorded there, and what happens there in all parts. */
#ifndef COMMUNICATION_POINTS_H
#define COMMUNICATION_POINTS_H

#include "macro_step.h"

static const double FIRST = 1e-3; /* macro step, of the span */

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
    self->known = self->looked = 0;
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
    self->next.t = self->now.t + FIRST * (system->stop - system->start);
    if (system->ends) self->next.t = fmin(self->next.t, system->stop);
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
    const long long part = self->system->part;
    if (restore_all_but(self, here && !self->ends ? self->system->parts + part : NULL))
        return CALL_FAILED;
    if (!here) return DONE;
    if (self->ends) return end_here(self);
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
    self->rateless = self->powers = 0;
    if (self->switched) forget_past(self);
    system->time = self->now.t;
    for (; is_before(system, system->rows, self->now.t); ++system->rows) { /* within the step */
        const int how = check_row(self, system->rows);
        if (how != DONE) return how;
    }
    for (long long p = 0; p < system->n_parts; ++p)
        if (system->parts[p].ends) return give_up(self, p), end_here(self);
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

#endif
