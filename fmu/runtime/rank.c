/* Singular configurations, where the constraints of a model lose rank. */
#include "rank.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "constants.h"
#include "cubic.h"
#include "equations.h"
#include "logging.h"
#include "projection.h"

#if HAS_RANK

static const double FURTHEST = 2; /* lengths of a cubic, beyond its end */

enum { POINTS = 32, ZOOMS = 4 };

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

/* The distance on the cubic through the states and derivatives of two evaluations. */
static double distance_on(Instance *self, const Look *from, const Look *to, double share) {
    const double h = to->time - from->time, t = from->time + share * h;
    const double *values = self->state.values;
    double x[NX], rate;
    for (int i = 0; i < NX; i++)
        x[i] = on_cubic(from->x[i], to->x[i], from->dx[i], to->dx[i], h, share, &rate);
    pass_point(self, &t, x, values + FIRST_ALGEBRAIC, values + FIRST_INPUT);
    return rank_at(self, NULL);
}

typedef struct {
    double distance, when;
} Nearest;

/* The point of that cubic nearest to a singular configuration, between shares of its length. */
static Nearest nearest_on(Instance *self, const Look *from, const Look *to, double begin,
                          double end) {
    Nearest nearest = {DBL_MAX, from->time};
    double low = begin, high = end, best = begin;
    for (int zoom = 0; zoom < ZOOMS; zoom++) {
        const double width = (high - low) / POINTS, first = low;
        for (int i = 0; i <= POINTS; i++) {
            const double share = first + i * width;
            const double distance = distance_on(self, from, to, share);
            if (!(distance < nearest.distance)) continue;
            nearest = (Nearest){distance, from->time + share * (to->time - from->time)};
            best = share;
        }
        low = fmax(begin, best - width);
        high = fmin(end, best + width);
    }
    return nearest;
}

static Nearest nearer(Nearest a, Nearest b) {
    return b.distance < a.distance ? b : a;
}

Status watch_rank(Instance *self, Status status) {
    const Watch watch = self->state.watch;
    const Look last = watch.last, now = look(self);
    if (watch.looks == 0 || !(now.time > last.time)) {
        begin_watch(self);
        return OK;
    }
    self->state.watch = (Watch){2, now, last, DBL_MAX, 0};
    Nearest nearest = {now.distance, now.time};
    if (watch.when <= now.time) {
        nearest = nearer(nearest, (Nearest){watch.least, watch.when});
    } else { /* it was evaluated ahead */
        self->state.watch.least = watch.least;
        self->state.watch.when = watch.when;
    }
    if (last.rate < 0 && now.rate > 0) {
        nearest = nearer(nearest, nearest_on(self, &last, &now, 0, 1));
        /* and along what the motion was before, lest it has left its branch */
        const double further = (now.time - last.time) / (last.time - watch.before.time);
        if (watch.looks > 1 && further <= FURTHEST)
            nearest = nearer(nearest, nearest_on(self, &watch.before, &last, 1, 1 + further));
    }
    if (nearest.distance >= LEAST_RANK) return OK;
    return refuse(self, status,
                  "the constraints lose rank at time %.6g (constraint_condition %.0e), where "
                  "branches of motion meet; from there on it may be another one%s",
                  nearest.when, 1 / fmax(nearest.distance, 1e-16),
                  self->state.interface == INTERFACE_ME && SOLVER_DOP853
                      ? ": use co-simulation, whose solver passes such places on its branch"
                      : "");
}

#else
typedef int no_watch; /* C knows no empty file */
#endif
