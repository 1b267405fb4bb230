/* Runs of one model with events, each from its start to its end, without a call of the caller.
 *
 * What happens at the start and at the end is done here as the caller of a run does it. A run in
 * which anything happens that the solver does not go through by itself (see timed.h: a relation
 * slides, an event ends it, it fails, it is stiff where the caller has a solver for that) is left
 * to the caller, from its start.
 */
#ifndef BLOCK_H
#define BLOCK_H

#include "external.h"

/* What Python mirrors. Arrays have a row per run, but for the output times. */
typedef struct {
    long long runs, points, room, leaves_stiff; /* room: of events, of all runs */
    double relative, absolute, largest, span;
    const double *times, *x, *z, *u, *c, *nominal, *sizes; /* u: with modes of 1 */
    double *states, *unknowns, *inputs; /* a row per output time; inputs with modes */
    double *records, *report;           /* report: BLOCK_REPORT numbers */
} Block;

/* A run that is left to the caller, or is complete; or what remains after the block; or a run that
 * the solver fails in, or leaves as it is stiff. */
enum { LEFT_ALONE, COMPLETE, NOT_BEGUN, FAILED };

enum { BLOCK_REPORT = 4 }; /* one of these codes, steps, right-hand sides, events */

/* A run; x, z and u, which holds the modes, are the values at its present time. */
typedef struct {
    const Block *block;
    Problem problem;
    Watch watch;
    Switching switching;
    double x[NX + 1], z[NZ + 1], u[NU + 1];
    double *states, *unknowns, *inputs; /* a row per output time */
} BlockRun;

static inline int let_happen(BlockRun *self, double t, int relation) {
    return pass_event(&self->watch, &(Crossing){t, relation, t}, self->x, true);
}

static inline void write_row(BlockRun *self, long long k) {
    memcpy(self->states + k * NX, self->x, NX * sizeof *self->x);
    memcpy(self->unknowns + k * NZ, self->z, NZ * sizeof *self->z);
}

static inline int begin_run(BlockRun *self) {
    const double t = self->block->times[0];
    const Point at = {t, self->x, self->z, self->u};
    const Laws *laws = &self->watch.laws;
    Switching *switching = &self->switching;
    if (begin_modes(laws, switching, &at, self->block->span).reason != GOES_ON ||
        begin_events(laws, switching, &at).reason != GOES_ON || any_is(switching, SLIDES))
        return 1;
    if (EVENTS > 0) return let_happen(self, t, -1);
    plan(laws, switching, &at, t, self->watch.until, true, NEVER_AGAIN);
    return 0;
}

/* What happens at the stop time: a time event, or one that only rounding is before. */
static inline int end_run(BlockRun *self) {
    const double stop = self->watch.until;
    const Point at = {stop, self->x, self->z, self->u};
    Place place;
    if (next_until(&self->switching, stop) == stop) return let_happen(self, stop, -1);
    const int leaving = margins_at(&self->watch.laws, &self->switching, &at, &place)
                            ? leaving_at(&self->watch.laws, &self->switching, &place, AS_IS)
                            : -1;
    return leaving >= 0 ? let_happen(self, stop, leaving) : 0;
}

/* Inputs with the modes of each output time, which are those before the next event. */
static inline void write_inputs(const BlockRun *self, const double *record) {
    for (long long k = 0; k < self->block->points; ++k) {
        double *row = self->inputs + k * NU;
        while (record < self->watch.records && record[0] <= self->block->times[k]) record += RECORD;
        memcpy(row, self->u, NU * sizeof *row);
        if (record < self->watch.records)
            memcpy(row + NU - MODES, record + 1 + NX + NZ, MODES * sizeof *row);
    }
}

/* Runs from the start to the end. Returns 0 where that was possible, -1 where the solver fails. */
static inline int run_alone(BlockRun *self) {
    const Block *block = self->block;
    const long long last = block->points - 1;
    const double *first_record = self->watch.records;
    Course course = {block->times[0], 0, 1};
    if (begin_run(self)) return 1;
    write_row(self, 0);
    const Grid grid = {.begin = block->times[0],
                       .end = block->times[last],
                       .times = block->times + 1,
                       .points = last,
                       .states = self->states + NX,
                       .unknowns = NZ > 0 ? self->unknowns + NZ : NULL,
                       .largest = block->largest};
    const int code =
        integrate_timed(solver.integrate, &self->problem, &self->watch, &grid, self->x, &course);
    if (code != SUCCESS) return code == EVENT ? 1 : -1;
    memcpy(self->z, self->unknowns + last * NZ, NZ * sizeof *self->z);
    if (end_run(self)) return 1;
    write_row(self, last);
    write_inputs(self, first_record);
    return 0;
}

/* Runs what there is room for. */
SHARED void cosim_block(const Block *block, const double **arg, double **res, long long *iw,
                        double *w) {
    double *records = block->records;
    double *const last = records + block->room * RECORD;
    for (long long i = 0; i < block->runs; ++i) {
        double *report = block->report + i * BLOCK_REPORT;
        BlockRun self = {
            .block = block,
            .problem = {.c = block->c + i * NC,
                        .relative = block->relative,
                        .absolute = block->absolute,
                        .nominal = block->nominal + i * NX,
                        .leaves_stiff = block->leaves_stiff != 0},
            .watch = {.records = records,
                      .last_record = last,
                      .until = block->times[block->points - 1]},
            .states = block->states + i * block->points * NX,
            .unknowns = block->unknowns + i * block->points * NZ,
            .inputs = block->inputs + i * block->points * NU,
        };
        self.problem.z = self.z;
        self.problem.u = self.u;
        self.watch.switching = &self.switching;
        link_to_model(&self.problem, &self.watch, block->sizes + i * NX, arg, res, iw, w);
        if (has_states(&self.watch.laws)) self.problem.watch = &self.watch;
        memcpy(self.x, block->x + i * NX, NX * sizeof *self.x);
        memcpy(self.z, block->z + i * NZ, NZ * sizeof *self.z);
        memcpy(self.u, block->u + i * NU, NU * sizeof *self.u);
        const int left = run_alone(&self);
        const bool full =
            i > 0 && self.watch.records == last; /* it is the first of the next block */
        report[0] = !left ? COMPLETE : full || halted ? NOT_BEGUN : left < 0 ? FAILED : LEFT_ALONE;
        report[1] = (double)self.problem.steps;
        report[2] = (double)self.problem.calls;
        report[3] = left ? 0 : (double)((self.watch.records - records) / RECORD);
        if (report[0] == NOT_BEGUN) return;
        if (!left) records = self.watch.records;
    }
}

#endif
