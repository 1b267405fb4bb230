/* Singular configurations, where the constraints of a model lose rank. */
#include "rank.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "constants.h"
#include "cubic.h"
#include "equations.h"
#include "logging.h"
#include "margins.h"
#include "projection.h"

#if HAS_RANK

static const double FURTHEST = 2; /* lengths of a cubic, beyond its end */

double rank_at(Instance *self, double *rate) {
    double distance = 0;
    self->res[0] = &distance;
    if (model_rank(self->arg, self->res, self->iw, self->w, 0) || !isfinite(distance)) distance = 0;
    if (!rate) return distance;
    *rate = 0;
    self->res[0] = rate;
    if (model_rank_rate(self->arg, self->res, self->iw, self->w, 0) || !isfinite(*rate)) *rate = 0;
    return distance;
}

bool keep_constraints(Instance *self, double t, const double u[], double x[]) {
    self->arg[2] = u;
    self->arg[3] = self->constants;
    const Work work = {self->arg, self->res, self->iw, self->w};
    return !project_state(model_project, &work, t, x);
}

static Look look(Instance *self) {
    const double *values = self->state.values;
    Look now = {.time = values[TIME]};
    pass_values(self);
    now.distance = rank_at(self, &now.rate);
    memcpy(now.x, values + FIRST_STATE, NX * sizeof *values);
    memcpy(now.dx, values + FIRST_DERIVATIVE, NX * sizeof *values);
    return now;
}

void begin_watch(Instance *self) {
    self->state.watch = (Watch){.looks = 1, .last = look(self), .least = DBL_MAX};
}

void note_rank(Instance *self) {
    const double *values = self->state.values;
    Watch *watch = &self->state.watch;
    if (watch->looks == 0 || !(values[TIME] > watch->last.time)) return;
    pass_values(self);
    const double distance = rank_at(self, NULL);
    if (!(distance < watch->least)) return;
    if (distance < LEAST_RANK && watch->least >= LEAST_RANK) /* a solver may end before its step */
        log_text(self, WARNING,
                 "near time %.6g the constraints lose rank, where branches of motion meet",
                 values[TIME]);
    watch->least = distance;
    watch->when = values[TIME];
}

/* The cubic through the states and derivatives of two evaluations. */
typedef struct {
    Instance *fmu;
    const Look *from, *to;
} Way;

static void look_on_way(void *way, double t, Place *found) {
    const Way *self = way;
    const Look *a = self->from, *b = self->to;
    const double h = b->time - a->time, *values = self->fmu->state.values;
    double x[NX], rate;
    for (int i = 0; i < NX; i++)
        x[i] = on_cubic(a->x[i], b->x[i], a->dx[i], b->dx[i], h, (t - a->time) / h, &rate);
    pass_point(self->fmu, &t, x, values + FIRST_ALGEBRAIC, values + FIRST_INPUT);
    note_no_event(t, found);
    found->inside[0] = rank_at(self->fmu, found->rates);
}

/* Where it comes nearest to a singular configuration up to a time, or the nearest place before. */
static Place nearest_on(Way *way, double begin, double end, Place nearest) {
    Place before, place;
    look_on_way(way, begin, &before);
    for (int k = 1; k <= PLACES; k++, before = place) {
        look_on_way(way, begin + (end - begin) * k / PLACES, &place);
        const bool turns = before.rates[0] < 0 && place.rates[0] > 0;
        const Place least = turns ? bottom(look_on_way, way, 0, before, place) : place;
        if (least.inside[0] < nearest.inside[0]) nearest = least;
    }
    return nearest;
}

Status watch_rank(Instance *self, Status status) {
    const Watch watch = self->state.watch;
    const Look last = watch.last, now = look(self);
    if (watch.looks == 0 || !(now.time > last.time)) {
        begin_watch(self);
        return OK;
    }
    self->state.watch = (Watch){2, now, last, DBL_MAX, 0};
    Place nearest = {.t = now.time, .inside = {now.distance}};
    if (watch.when > now.time) { /* it was evaluated ahead */
        self->state.watch.least = watch.least;
        self->state.watch.when = watch.when;
    } else if (watch.least < now.distance) {
        nearest = (Place){.t = watch.when, .inside = {watch.least}};
    }
    if (last.rate < 0 && now.rate > 0) {
        const double length = now.time - last.time, before = last.time - watch.before.time;
        nearest = nearest_on(&(Way){self, &last, &now}, last.time, now.time, nearest);
        /* and along what the motion was before, lest it has left its branch */
        if (watch.looks > 1 && length <= FURTHEST * before)
            nearest = nearest_on(&(Way){self, &watch.before, &last}, last.time, now.time, nearest);
    }
    if (nearest.inside[0] >= LEAST_RANK) return OK;
    return refuse(self, status,
                  "the constraints lose rank at time %.6g (constraint_condition %.0e), where "
                  "branches of motion meet; from there on it may be another one%s",
                  nearest.t, 1 / fmax(nearest.inside[0], 1e-16),
                  self->state.interface == INTERFACE_ME && SOLVER_DOP853
                      ? ": use co-simulation, whose solver passes such places on its branch"
                      : "");
}

#else
typedef int no_watch; /* C knows no empty file */
#endif
