/* The relations of the equations, looked at as a solver goes: a step in which one leaves its mode
 * ends exactly there, and the kernel of events tells what follows.
 *
 * watch(t, x, z, u, c, dx) -> (arguments, rates, modes, rates of modes): of the relations, at
 * solved unknowns z; modes that follow from an argument that stays 0 are part of the equations.
 */
#ifndef WATCH_H
#define WATCH_H

#include "model_laws.h"
#include "problem.h"
#include "search.h"

enum { RECORD = 1 + 2 * (NX + NZ + MODES) + MODES + EVENTS };

/* What a run with events goes on from. */
typedef struct {
    Problem *problem;
    Equations *watch;
    Laws laws;
    LawOwner owner;
    Switching *switching;
    double *records, *last_record; /* where the next event is written, and where room ends */
    int relation;                  /* which one ended the run; -1: none */
    double until;                  /* end of the run, up to which time events are planned */
} Watch;

/* A step that was accepted: its states within it, a fresh step to a time in it. */
typedef struct {
    Watch *watch;
    double t, end; /* up to that time the motion goes on as it is, and there as `beyond` tells */
    Beyond beyond;
    void *motion;
    int (*within)(void *motion, double t, double *x, double *dx);
    int (*step_to)(void *motion, double t, double *x);
    const double *slopes; /* of its stages */
    int stages;
    Quintic *quintic;     /* NULL: the motion is as accurate as the states */
    const Off *off;       /* by how much it may be off; NULL: by nothing */
    bool proven;          /* by bounds, that no relation with these leaves its mode in it */
    const double *looked; /* the output times before it have been looked at */
    double fresh[NX];     /* the state at the end of the last fresh step */
} Step;

/* Whether any relation is not of time alone. */
static inline bool has_states(const Laws *laws) {
    for (int i = 0; i < MODES; ++i)
        if (!laws->relations[i].of_time) return true;
    return false;
}

static inline bool relations_at(const Watch *self, double t, const double *x, double *z,
                                const double *dx, Seen *seen, double *modes, double *towards) {
    return call_law(&self->owner, self->watch, &(Point){t, x, z, self->problem->u}, dx,
                    (Results){seen->arguments, seen->rates, modes, towards});
}

/* Whether an argument stays 0 by the equations, wherever the solver's motion goes. */
static inline int is_kept(const Watch *self, double t, const double *x, int i) {
    double slopes[NX], solved[NZ + 1], modes[MODES + 1], towards[MODES + 1];
    Seen exact = {.arguments = {0}};
    return !equations_at(self->problem, t, x, slopes, solved) &&
           relations_at(self, t, x, solved, slopes, &exact, modes, towards) &&
           fabs(exact.rates[i]) <= self->switching->stays[i];
}

/* Margins at a state whose derivatives and algebraic unknowns are known. Returns 0 with a value. */
static inline int look(const Watch *self, double t, const double *x, double *z, const double *dx,
                       Place *found) {
    const Switching *s = self->switching;
    double modes[MODES + 1], towards[MODES + 1];
    Seen seen = {.arguments = {0}};
    found->t = t;
    if (!relations_at(self, t, x, z, dx, &seen, modes, towards)) return 1;
    measure(&self->laws, s, modes, &seen, found->inside, found->rates);
    for (int i = 0; i < MODES; ++i) {
        if (s->state[i] == SLIDES) found->rates[i] = modes[i] > 0 ? -towards[i] : towards[i];
        if (s->state[i] == HELD && found->inside[i] < s->slack[i] && is_kept(self, t, x, i))
            found->inside[i] = s->slack[i];
    }
    return 0;
}

/* The same where the derivatives and the algebraic unknowns are not known yet. */
static inline int look_afresh(const Watch *self, double t, const double *x, double *dx,
                              Place *found) {
    double z[NZ + 1];
    return equations_at(self->problem, t, x, dx, z) || look(self, t, x, z, dx, found);
}

/* Boundaries that an event has displaced are back as soon as a step ends within them. */
static inline void let_go(const Watch *self, double t, const double *x) {
    double dx[NX], z[NZ + 1], modes[MODES + 1], towards[MODES + 1];
    Seen seen = {.arguments = {0}};
    if (!any_is(self->switching, LEAVES) || equations_at(self->problem, t, x, dx, z)) return;
    if (relations_at(self, t, x, z, dx, &seen, modes, towards))
        note_inside(&self->laws, self->switching, modes, seen.arguments);
}

static inline void look_at(const Step *self, double t, double *x, Place *found) {
    double dx[NX], slopes[NX], z[NZ + 1];
    const int lost = self->within(self->motion, t, x, dx) ||
                     (NZ > 0 && equations_at(self->watch->problem, t, x, slopes, z)) ||
                     look(self->watch, t, x, z, dx, found);
    if (lost) note_no_event(t, found);
}

static inline void look_within(void *accepted, double t, Place *found) {
    double x[NX];
    look_at(accepted, t, x, found);
}

static inline bool stays(void *accepted, const Place *a, const Place *b) {
    const Step *self = accepted;
    const Watch *watch = self->watch;
    double dx[NX], slopes[NU + 1], *z = watch->problem->z, *u = watch->problem->u;
    Sample samples[NODES];
    if (ENCLOSED == 0 || self->proven) return true;
    for (int k = 0; k < NODES; ++k) {
        const Point at = {node_between(a->t, b->t, k), samples[k], z, u};
        if (self->within(self->motion, at.t, samples[k], dx) ||
            !law_inputs(&watch->owner, &at, samples[k] + NX, slopes))
            return true;
    }
    const Point from = {a->t, samples[0], z, u};
    return sampled_stays_within(&watch->laws, watch->switching, &from, b->t - a->t,
                                (const Sample *)samples, self->off, a->inside, b->inside);
}

/* Whether bounds prove that no relation leaves its mode in the whole step. */
static inline bool is_quiet(Step *self, const double *x, const Place *a, const Place *b) {
    const Watch *watch = self->watch;
    const double *u = watch->problem->u;
    const Point at = {a->t, x, watch->problem->z, watch->problem->u};
    Spans spans;
    if (ENCLOSED == 0) return true;
    for (int i = 0; i < NU - MODES; ++i) {
        spans.low[NX + i] = spans.high[NX + i] = u[i];
        spans.slowest[NX + i] = spans.fastest[NX + i] = 0;
    }
    if (!model_laws.inputs &&
        stays_by_slopes(&watch->laws, watch->switching, &at, b->t - a->t, self->slopes,
                        self->stages, &spans, a->inside, b->inside))
        return true;
    return self->quintic ? stays_sharply(stays, self, self->quintic, &self->off, a, b)
                         : stays(self, a, b);
}

static inline bool step_freshly(void *accepted, double t, Place *found) {
    Step *self = accepted;
    double dx[NX];
    return !self->step_to(self->motion, t, self->fresh) &&
           !look_afresh(self->watch, t, self->fresh, dx, found);
}

/* Takes what rounding makes of the arguments at a place, and looks at it and a later one anew. */
static inline void look_closely_at(const Step *self, Place *first, Place *last) {
    double x[NX], dx[NX];
    const Problem *problem = self->watch->problem;
    const Point at = {first->t, x, problem->z, problem->u};
    if (self->within(self->motion, first->t, x, dx)) return;
    note_slack(&self->watch->laws, self->watch->switching, &at);
    look_at(self, first->t, x, first);
    look_at(self, last->t, x, last);
}

/* The first crossing in an accepted step, from the place where it begins to the one where it ends:
 * at the output times in it, whose columns take the states, and between all these places. Where
 * there is one, `fresh` is the state. x: where the step begins. Returns 0 unless a fresh step
 * fails. */
static inline int crossing_of(Step *self, const double *x, const double *times, double *columns,
                              const Place *begin, Place *end, Crossing *found) {
    const Laws *laws = &self->watch->laws;
    Switching *s = self->watch->switching;
    Place before = *begin, place;
    note_steps(s, end->t, 1);
    self->proven = false; /* that of the step before */
    self->proven = outside(begin) < 0 && outside(end) < 0 && is_quiet(self, x, begin, end);
    self->looked = times;
    *found = (Crossing){end->t, -1, end->t};
    for (const double *time = times; before.t < end->t; before = place) {
        while (*time <= before.t && *time < end->t) ++time;
        if (*time < end->t) {
            look_at(self, *time, columns + (time - times) * NX, &place);
            self->looked = time + 1;
        } else {
            place = *end;
        }
        const Beyond beyond = place.t < self->end ? AS_IS : self->beyond;
        if (!is_suspect(laws, s, &before, &place, beyond) && stays(self, &before, &place)) continue;
        sharpen_fully(self->quintic);
        look_closely_at(self, &before, &place);
        if (find_crossing(look_within, stays, step_freshly, self, laws, s, self->t, before, place.t,
                          beyond, found) == FAILS)
            return 1;
        if (found->relation >= 0) return 0;
        if (place.t == end->t) *end = place;
    }
    *found = (Crossing){end->t, -1, end->t};
    return 0;
}

static inline void append(double **end, const double *values, int count) {
    memcpy(*end, values, (size_t)count * sizeof **end);
    *end += count;
}

/* Records what was before and after an instant. */
static inline void record_event(Watch *self, const Point *before, const Point *after,
                                const Happening *found) {
    double *end = self->records, order[EVENTS + 1] = {0}, zero[MODES + 1];
    for (int i = 0; i < MODES; ++i) zero[i] = found->zero[i];
    for (int k = 0; k < found->count; ++k) order[found->happened[k]] = 1 + k;
    append(&end, &before->t, 1);
    append(&end, before->x, NX);
    append(&end, before->z, NZ);
    append(&end, before->u + NU - MODES, MODES);
    append(&end, after->x, NX);
    append(&end, after->z, NZ);
    append(&end, after->u + NU - MODES, MODES);
    append(&end, zero, MODES);
    append(&end, order, EVENTS);
    self->records = end;
}

/* Goes through the event at a crossing, or one of time (relation -1): x becomes the state after it,
 * and what was before and after is recorded. Returns 0 where the run goes on from there; otherwise
 * all is as before, and the caller has to go on: where relations slide, the run ends, or, unless
 * `plans`, time events change. */
static inline int pass_event(Watch *self, const Crossing *crossing, double *x, bool plans) {
    Problem *problem = self->problem;
    double state[NX], z[NZ + 1], u[NU + 1];
    const bool later[MODES + 1] = {0};
    const Switching saved = *self->switching;
    const Point at = {crossing->time, x, problem->z, problem->u};
    const Point before = {crossing->time, state, z, u};
    Happening found;
    bool replan;
    if (self->records == self->last_record) return 1;
    memcpy(state, x, sizeof state);
    memcpy(z, problem->z, NZ * sizeof *z);
    memcpy(u, problem->u, NU * sizeof *u);
    happen(&self->laws, self->switching, &at, x, crossing->relation, later, NULL, &found, &replan);
    if (found.ending.reason != GOES_ON || (replan && !plans) || any_is(self->switching, SLIDES)) {
        *self->switching = saved;
        memcpy(x, state, sizeof state);
        memcpy(problem->z, z, NZ * sizeof *z);
        memcpy(problem->u, u, NU * sizeof *u);
        return 1;
    }
    if (found.count > 0 || found.modes_changed) record_event(self, &before, &at, &found);
    if (replan) plan(&self->laws, self->switching, &at, at.t, self->until, true, NEVER_AGAIN);
    return 0;
}

/* Ends a run at a crossing, with the state there. */
static inline int ends_run(Watch *self, const Crossing *crossing, const double *fresh, double *x) {
    memcpy(x, fresh, NX * sizeof *x);
    self->relation = crossing->relation;
    return EVENT;
}

#endif
