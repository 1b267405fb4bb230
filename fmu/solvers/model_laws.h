/* The laws of a compiled model, for the kernel of events in a native run and in an FMU.
 *
 * Generated code provides the functions of relations and rules (see fmu/runtime/equations.h, with
 * constants c, of which the parameters are the first, for p), the tables of laws.h, and
 *
 *     model_inputs(t, u, c) -> (u, du/dt)    inputs that follow a series within a step.
 */
#ifndef MODEL_LAWS_H
#define MODEL_LAWS_H

#include "happen.h"
#include "ode.h"
#include "plan.h"

/* Generated code fills it. */
typedef struct {
    Equations *algebraic, *relations, *rounding, *timed, *conditions, *bounds, *enclosure;
    Equations *inputs;              /* NULL where inputs rest within a step */
    const Relation *relation_table; /* tables: see Laws */
    const Rule *rules;
    const int *assigned;
    const bool *adds;
    const int *barriers, *bounded, *enclosed;
} ModelLaws;

static const ModelLaws model_laws;

/* What the laws are called with. */
typedef struct {
    const double *c;      /* constants */
    const double *sizes;  /* of the states, in whose rounding an argument is 0 */
    const double *slopes; /* of the inputs, at an instant; NULL within a step, where they follow */
    const double **arg;   /* CasADi's work space */
    double **res;
    long long *iw;
    double *w; /* its WORK_W numbers, and the room of `Laws`: WORK_OF_LAWS */
    void (*move)(const void *owner, double t, double slopes[]); /* gives slopes; or NULL */
    const void *owner;                                          /* of `move` */
    const double *departure; /* second derivatives of inputs that rest, and move on; or NULL */
} LawOwner;

enum { RESULTS_OF_A_LAW = 5, WORK_OF_LAWS = WORK_W + MODES * MODES };
typedef double *Results[RESULTS_OF_A_LAW];

static inline bool call_law(const LawOwner *self, Equations *function, const Point *at,
                            const double *more, const Results results) {
    self->arg[0] = &at->t;
    self->arg[1] = at->x;
    self->arg[2] = at->z;
    self->arg[3] = at->u;
    self->arg[4] = self->c;
    self->arg[5] = more;
    for (int i = 0; i < RESULTS_OF_A_LAW; i++) self->res[i] = results[i];
    return !function(self->arg, self->res, self->iw, self->w, 0);
}

/* Inputs and modes at the time of a point, and slopes of the inputs. */
static inline bool law_inputs(const LawOwner *self, const Point *at, double u[], double slopes[]) {
    memcpy(u, at->u, NU * sizeof *u);
    memset(slopes, 0, NU * sizeof *slopes);
    if (self->move) {
        self->move(self->owner, at->t, slopes);
        return true;
    }
    if (self->slopes || !model_laws.inputs) {
        if (self->slopes) memcpy(slopes, self->slopes, NU * sizeof *slopes);
        return true;
    }
    self->arg[0] = &at->t;
    self->arg[1] = at->u;
    self->arg[2] = self->c;
    self->res[0] = u;
    self->res[1] = slopes;
    return !model_laws.inputs(self->arg, self->res, self->iw, self->w, 0);
}

/* The algebraic unknowns from their guess. */
static inline bool solve_law(const LawOwner *self, const Point *at) {
    double z[NZ + 1] = {0};
    if (NZ == 0) return true;
    if (!call_law(self, model_laws.algebraic, at, NULL, (Results){z})) return false;
    for (int i = 0; i < NZ; i++)
        if (!isfinite(z[i])) return false;
    memcpy(at->z, z, NZ * sizeof *z);
    return true;
}

/* Add what inputs that leave a rest mean for second derivatives, which are decisive where a rate is
 * 0. First derivatives are affine in the slopes of inputs, and so tell it. */
static inline bool add_departure(const LawOwner *self, const Point *at, Seen *seen) {
    const double none[NU + 1] = {0};
    Seen with, without;
    bool any = false;
    for (int i = 0; i < NU && self->departure; i++) any |= self->departure[i] != 0;
    if (!any) return true;
    if (!call_law(self, model_laws.relations, at, self->departure, (Results){NULL, with.rates}) ||
        !call_law(self, model_laws.relations, at, none, (Results){NULL, without.rates}))
        return false;
    for (int i = 0; i < MODES; i++) seen->seconds[i] += with.rates[i] - without.rates[i];
    return true;
}

static inline bool law_see(void *owner, const Point *at, Seen *seen) {
    double u[NU + 1];
    const Point now = {at->t, at->x, at->z, u};
    const Results found = {seen->arguments, seen->rates, seen->seconds, seen->sizes, seen->slopes};
    return law_inputs(owner, at, u, seen->moves) && solve_law(owner, &now) &&
           call_law(owner, model_laws.relations, &now, seen->moves, found) &&
           add_departure(owner, &now, seen);
}

static inline bool law_decide(void *owner, const Point *at, Decision *found) {
    double u[NU + 1], slopes[NU + 1];
    const Point now = {at->t, at->x, at->z, u};
    return law_inputs(owner, at, u, slopes) && solve_law(owner, &now) &&
           call_law(owner, model_laws.conditions, &now, NULL,
                    (Results){found->conditions, found->values, found->defects});
}

static inline bool law_spread(void *owner, const Point *at, Spread *found) {
    const LawOwner *self = owner;
    double u[NU + 1], slopes[NU + 1];
    const Point now = {at->t, at->x, at->z, u};
    return model_laws.rounding && law_inputs(owner, at, u, slopes) &&
           call_law(owner, model_laws.rounding, &now, self->sizes,
                    (Results){found->sized, found->least, found->rates});
}

static inline bool law_timed(void *owner, const Point *at, double t, double arguments[],
                             double rates[]) {
    const Point then = {t, at->x, at->z, at->u};
    return call_law(owner, model_laws.timed, &then, NULL, (Results){arguments, rates});
}

static inline bool law_bounds(void *owner, const Point *at, double t, double length, double low[],
                              double high[]) {
    const Point then = {t, at->x, at->z, at->u};
    return call_law(owner, model_laws.bounds, &then, &length, (Results){low, high});
}

static inline bool law_enclose(void *owner, const Point *at, double length, const Spans *spans,
                               double low[], double high[]) {
    const LawOwner *self = owner;
    self->arg[0] = &at->t;
    self->arg[1] = &length;
    self->arg[2] = spans->low;
    self->arg[3] = spans->high;
    self->arg[4] = spans->slowest;
    self->arg[5] = spans->fastest;
    self->arg[6] = at->u;
    self->arg[7] = self->c;
    self->res[0] = low;
    self->res[1] = high;
    return !model_laws.enclosure(self->arg, self->res, self->iw, self->w, 0);
}

static inline Laws laws_of_model(LawOwner *owner) {
    return (Laws){
        .owner = owner,
        .relations = model_laws.relation_table,
        .rules = model_laws.rules,
        .assigned = model_laws.assigned,
        .adds = model_laws.adds,
        .barriers = model_laws.barriers,
        .bounded = model_laws.bounded,
        .enclosed = model_laws.enclosed,
        .room = owner->w + WORK_W,
        .see = law_see,
        .decide = law_decide,
        .spread = law_spread,
        .timed = law_timed,
        .bounds = law_bounds,
        .enclose = law_enclose,
    };
}

#endif
