/* The kernel of events as functions of a library, for runs whose solver does not call it itself.
 *
 * Each function works on what a `Call` points to. The workspace is its own, so that threads with
 * calls of their own may share a library.
 */
#ifndef INSTANTS_H
#define INSTANTS_H

#include "interrupt.h"
#include "model_laws.h"

#if !defined LAWS_ARG || !defined LAWS_RES || !defined LAWS_IW || !defined LAWS_W
#error "define LAWS_ARG, LAWS_RES, LAWS_IW and LAWS_W, the workspace of the functions of the laws"
#endif

/* What Python mirrors; its size is compared when a library is loaded. */
typedef struct {
    double t, span;
    double *x, *z, *u;                /* with modes; after an instant, the values after it */
    const double *slopes, *c, *sizes; /* of the inputs with modes; constants; of the states */
    double *switching;                /* a `Switching` */
    double *modes;                    /* before an instant */
    double *zero, *order;             /* of relations and rules, see Happening */
    double *later; /* relations that keep their modes, although their arguments are 0 */
    void (*note)(const double *z, const double *u, const double *x, const double *risen);
    long long reason, part, other, state; /* of the ending */
    double size;
    long long replan, rounds;
} Call;

typedef struct {
    LawOwner owner;
    Laws laws;
    Point at;
    Switching *switching;
    const double *arg[LAWS_ARG];
    double *res[LAWS_RES];
    long long iw[LAWS_IW];
    double w[LAWS_W];
} Kernel;

static inline void open_kernel(Kernel *self, const Call *call) {
    self->owner = (LawOwner){call->c,  call->sizes, call->slopes, self->arg, self->res,
                             self->iw, self->w,     NULL,         NULL};
    self->laws = laws_of_model(&self->owner);
    self->at = (Point){call->t, call->x, call->z, call->u};
    self->switching = (Switching *)(void *)call->switching;
}

static inline void tell(Call *call, const Ending *found) {
    call->reason = found->reason;
    call->part = found->part;
    call->other = found->other;
    call->state = found->state;
    call->size = found->size;
}

/* Sizes that Python compares: of a call, of `Switching` in numbers, and of the laws. */
SHARED void cosim_kernel_sizes(long long *out) {
    const long long sizes[] = {sizeof(Call), SWITCHING_SIZE, NX, NZ, NU, MODES, EVENTS};
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
    call->rounds = found.rounds;
    memcpy(call->modes, found.modes, MODES * sizeof *call->modes);
    for (int i = 0; i < MODES; i++) call->zero[i] = found.zero[i];
    for (int i = 0; i < EVENTS; i++) call->order[i] = 0;
    for (int k = 0; k < found.count; k++) call->order[found.happened[k].rule] = 1 + k;
}

/* The next time event up to an end, after the present time. */
SHARED void cosim_plan(Call *call, double end) {
    Kernel self;
    open_kernel(&self, call);
    plan(&self.laws, self.switching, &self.at, call->t, end, true, NEVER_AGAIN);
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

/* Boundaries that an event has displaced are back where arguments have been inside since. */
SHARED void cosim_note_inside(Call *call, const double *modes, const double *arguments) {
    Kernel self;
    open_kernel(&self, call);
    note_inside(&self.laws, self.switching, modes, arguments);
}

#endif
