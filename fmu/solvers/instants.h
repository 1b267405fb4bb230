/* The kernel of events as functions of a library, for runs whose solver does not call it itself.
 *
 * Each function works on what a `Call` points to. The workspace is its own, so that threads with
 * calls of their own may share a library.
 */
#ifndef INSTANTS_H
#define INSTANTS_H

#include "cubic.h"
#include "interrupt.h"
#include "model_laws.h"
#include "search.h"

#if !defined WORK_ARG || !defined WORK_RES || !defined WORK_IW || !defined WORK_W
#error "define WORK_ARG, WORK_RES, WORK_IW and WORK_W, the work space of the functions of the laws"
#endif

/* What Python mirrors; its size is compared when a library is loaded. */
typedef struct {
    double t, span;
    double *x, *z, *u;                /* with modes; after an instant, the values after it */
    double *w;                        /* work space, whose size `cosim_kernel_sizes` tells */
    const double *slopes, *c, *sizes; /* of the inputs with modes; constants; of the states */
    double *switching;                /* a `Switching` */
    double *zero, *order;             /* of relations and rules, see Happening */
    double *later; /* relations that keep their modes, although their arguments are 0 */
    void (*note)(const double *z, const double *u, const double *x, const double *risen);
    long long reason, part, other, state; /* of the ending */
    double size;
    long long replan;
} Call;

/* MotionRows of a motion, which is near a cubic from each to the next one. */
typedef struct {
    const double *times, *x, *dx, *u, *du; /* with modes */
    const double *inside, *defects;        /* margins; what the slopes of the cubics are off by */
} MotionRows;

typedef struct {
    LawOwner owner;
    Laws laws;
    Point at;
    Switching *switching;
    const double *arg[WORK_ARG + 1];
    double *res[WORK_RES + 1];
    long long iw[WORK_IW + 1];
} Kernel;

static inline Switching *switching_of(const Call *call) {
    return (Switching *)(void *)call->switching;
}

static inline void open_kernel(Kernel *self, const Call *call) {
    self->owner = (LawOwner){call->c,  call->sizes, call->slopes, self->arg, self->res,
                             self->iw, call->w,     NULL,         NULL,      NULL};
    self->laws = laws_of_model(&self->owner);
    self->at = (Point){call->t, call->x, call->z, call->u};
    self->switching = switching_of(call);
}

static inline void tell(Call *call, const Ending *found) {
    call->reason = found->reason;
    call->part = found->part;
    call->other = found->other;
    call->state = found->state;
    call->size = found->size;
}

/* Sizes of structures and of the laws, which Python compares; of `Switching` and of the work space,
 * in numbers. */
SHARED void cosim_kernel_sizes(long long *out) {
    const long long sizes[] = {sizeof(Call), sizeof(MotionRows), NX,          NZ, NU, MODES,
                               EVENTS,       SWITCHING_SIZE,     WORK_OF_LAWS};
    memcpy(out, sizes, sizeof sizes);
}

/* Modes of a start, and the conditions before it. */
SHARED void cosim_begin(Call *call) {
    Kernel self;
    open_kernel(&self, call);
    Ending found = begin_modes(&self.laws, self.switching, &self.at, call->span);
    if (found.reason == GOES_ON) found = begin_events(&self.laws, self.switching, &self.at);
    tell(call, &found);
}

static inline void note_round(void *caller, const Point *before, const bool risen[]) {
    const Call *call = caller;
    double which[EVENTS + 1] = {0};
    for (int i = 0; i < EVENTS; i++) which[i] = risen[i];
    call->note(before->z, before->u, before->x, which);
}

/* All that happens at an instant; `crossing`: the relation whose argument is 0, or -1. */
SHARED void cosim_happen(Call *call, long long crossing) {
    Kernel self;
    Happening found;
    bool replan;
    const Listener listener = {note_round, call};
    bool later[MODES + 1] = {0};
    open_kernel(&self, call);
    for (int i = 0; i < MODES; i++) later[i] = call->later[i] > 0;
    happen(&self.laws, self.switching, &self.at, call->x, (int)crossing, later,
           call->note ? &listener : NULL, &found, &replan);
    tell(call, &found.ending);
    call->replan = replan;
    for (int i = 0; i < MODES; i++) call->zero[i] = found.zero[i];
    for (int i = 0; i < EVENTS; i++) call->order[i] = 0;
    for (int k = 0; k < found.count; k++) call->order[found.happened[k]] = 1 + k;
}

/* Plans time events after the present time, up to the end of the run. */
SHARED void cosim_plan(Call *call, double end) {
    Kernel self;
    open_kernel(&self, call);
    plan(&self.laws, self.switching, &self.at, call->t, end, true, NEVER_AGAIN);
}

/* The next of them. */
SHARED double cosim_due(const Call *call, double end) {
    return next_until(switching_of(call), end);
}

/* Margins and their rates of n rows of arguments, their rates, and modes. */
SHARED void cosim_margins(Call *call, long long n, const double *arguments, const double *rates,
                          const double *modes, double *inside, double *towards) {
    Kernel self;
    Seen seen;
    open_kernel(&self, call);
    for (long long k = 0; k < n; k++) {
        const long long row = k * MODES;
        memcpy(seen.arguments, arguments + row, MODES * sizeof *arguments);
        memcpy(seen.rates, rates + row, MODES * sizeof *rates);
        measure(&self.laws, self.switching, modes + row, &seen, inside + row, towards + row);
    }
}

/* The relation that leaves its mode at each of n rows, or -1. */
SHARED void cosim_leaving(Call *call, long long n, const double *times, const double *inside,
                          const double *towards, double *found) {
    Kernel self;
    Place place;
    open_kernel(&self, call);
    for (long long k = 0; k < n; k++) {
        place.t = times[k];
        memcpy(place.inside, inside + k * MODES, MODES * sizeof *inside);
        memcpy(place.rates, towards + k * MODES, MODES * sizeof *towards);
        found[k] = leaving_at(&self.laws, self.switching, &place, AS_IS);
    }
}

/* Whether no relation leaves its mode from one row to a later one. */
static inline bool rows_stay(Kernel *self, const MotionRows *rows, long long first,
                             long long last) {
    Spans spans;
    const double *inside = rows->inside + first * MODES;
    clear_spans(&spans);
    for (long long k = first; k < last; k++) {
        const double length = rows->times[k + 1] - rows->times[k];
        const double *x = rows->x + k * NX, *dx = rows->dx + k * NX;
        const double *u = rows->u + k * NU, *du = rows->du + k * NU;
        if (!(length > 0)) continue;
        for (int i = 0; i < NX; i++)
            span_cubic(x[i], x[i + NX], (const double[]){dx[i], dx[i + NX]}, length,
                       rows->defects[k * NX + i], i, &spans);
        for (int i = 0; i < NU - MODES; i++)
            span_cubic(u[i], u[i + NU], (const double[]){du[i], du[i + NU]}, length, 0, NX + i,
                       &spans);
    }
    self->at.t = rows->times[first];
    return stays_within(&self->laws, self->switching, &self->at,
                        rows->times[last] - rows->times[first], &spans, inside,
                        rows->inside + last * MODES);
}

enum { TOGETHER = 8 }; /* rows that are tried at once */

/* From which of n rows to the next no relation leaves its mode. */
SHARED void cosim_stay(Call *call, const MotionRows *rows, long long n, double *stay) {
    Kernel self;
    open_kernel(&self, call);
    for (long long first = 0; first < n - 1; first += TOGETHER) {
        const long long last = first + TOGETHER < n - 1 ? first + TOGETHER : n - 1;
        const bool all = rows_stay(&self, rows, first, last);
        for (long long k = first; k < last; k++) stay[k] = all || rows_stay(&self, rows, k, k + 1);
    }
}

/* Margins and their rates at a time, by a fresh run from the first of two rows; false to end. */
typedef bool FreshRun(double t, double *inside, double *rates);

typedef struct {
    Kernel *kernel;
    const MotionRows *rows; /* two of them */
    FreshRun *run;          /* NULL: the motion is the cubic */
} Cubic;

static inline void move_on_cubic(const Cubic *self, double t, double x[], double u[], double du[]) {
    const MotionRows *rows = self->rows;
    const double length = rows->times[1] - rows->times[0], s = (t - rows->times[0]) / length;
    double rate;
    for (int i = 0; i < NX; i++)
        x[i] =
            on_cubic(rows->x[i], rows->x[i + NX], rows->dx[i], rows->dx[i + NX], length, s, &rate);
    for (int i = 0; i < NU; i++)
        u[i] =
            on_cubic(rows->u[i], rows->u[i + NU], rows->du[i], rows->du[i + NU], length, s, &du[i]);
}

static inline void look_on_cubic(void *cubic, double t, Place *found) {
    const Cubic *self = cubic;
    Kernel *kernel = self->kernel;
    double x[NX + 1], z[NZ + 1], u[NU + 1], du[NU + 1];
    move_on_cubic(self, t, x, u, du);
    memcpy(z, kernel->at.z, NZ * sizeof *z);
    kernel->owner.slopes = du;
    margins_at(&kernel->laws, kernel->switching, &(Point){t, x, z, u}, found);
}

static inline bool stays_on_cubic(void *cubic, const Place *a, const Place *b) {
    const Cubic *self = cubic;
    const Kernel *kernel = self->kernel;
    Sample samples[NODES];
    double du[NU + 1];
    /* bounds know no modes between -1 and 1 */
    if (ENCLOSED == 0 || any_is(kernel->switching, SLIDES)) return true;
    for (int k = 0; k < NODES; k++)
        move_on_cubic(self, node_between(a->t, b->t, k), samples[k], samples[k] + NX, du);
    const Point at = {a->t, kernel->at.x, kernel->at.z, kernel->at.u};
    return sampled_stays_within(&kernel->laws, kernel->switching, &at, b->t - a->t,
                                (const Sample *)samples, NULL, a->inside, b->inside);
}

static inline bool run_to(void *cubic, double t, Place *found) {
    const Cubic *self = cubic;
    found->t = t;
    return self->run(t, found->inside, found->rates);
}

/* Where a relation leaves its mode between two rows: the relation, or -1. `goes_on`: beyond the
 * second one the motion goes on as it is. */
SHARED long long cosim_search(Call *call, const MotionRows *rows, FreshRun *run, long long goes_on,
                              double *time) {
    const double begin = rows->times[0], end = rows->times[1];
    Kernel self;
    Cubic cubic = {&self, rows, run};
    Place before, place;
    Crossing found;
    open_kernel(&self, call);
    if (run) note_slack(&self.laws, self.switching, &(Point){begin, rows->x, self.at.z, self.at.u});
    look_on_cubic(&cubic, begin, &before);
    if (run) {
        find_crossing(look_on_cubic, stays_on_cubic, run_to, &cubic, &self.laws, self.switching,
                      begin, before, end, goes_on ? AS_IS : BY_EVENTS, &found);
    } else {
        found.relation =
            crossing_between(look_on_cubic, stays_on_cubic, &cubic, before, end, &place);
        found.time = place.t;
    }
    *time = found.time;
    return found.relation;
}

/* What rounding makes of slow relations at a point of the motion. */
SHARED void cosim_note_least(Call *call) {
    Kernel self;
    Spread found;
    open_kernel(&self, call);
    note_least(&self.laws, self.switching, &self.at, &found);
}

/* A solver that knows no events has taken some steps up to a time. */
SHARED void cosim_note_steps(Call *call, double t, double steps) {
    note_steps(switching_of(call), t, steps * LOCATED / DBL_EPSILON);
}

/* Boundaries that an event has displaced are back where arguments have been inside since. */
SHARED void cosim_note_inside(Call *call, const double *modes, const double *arguments) {
    Kernel self;
    open_kernel(&self, call);
    note_inside(&self.laws, self.switching, modes, arguments);
}

#endif
