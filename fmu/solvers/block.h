/* Runs of one model with events, each from its start to its end, without a call of the caller.
 *
 * What the solver does not go through by itself (see watch.h) is done here as the caller of a run
 * does it: the start, and time events. A run in which anything else happens (a relation slides, an
 * event ends it, it fails, it is stiff where the caller has a solver for that) is left to the
 * caller, from its start.
 */
#ifndef BLOCK_H
#define BLOCK_H

#include "external.h"

/* What Python mirrors. Arrays have a row per run, but for the output times and the work space of
 * (points + 1) (1 + NX + NZ) numbers. */
typedef struct {
    long long runs, points, room, watches, leaves_stiff; /* room: of events, of all runs */
    double relative, absolute, largest, span;
    const double *times, *constant; /* constant: 1 for states that only events change */
    const double *x, *z, *u, *c, *nominal, *sizes; /* u: with modes of 1 */
    double *states, *unknowns, *inputs;            /* a row per output time; inputs with modes */
    double *records, *report, *work;               /* report: BLOCK_REPORT numbers */
} Block;

/* A run that is left to the caller, or is complete; or what remains after the block; or a run that
 * the solver fails in, or leaves as it is stiff. */
enum { LEFT_ALONE, COMPLETE, NOT_BEGUN, FAILED };

enum { SAME_INSTANT = 32 }; /* units in the last place of a time, as in location.py */
enum { BLOCK_REPORT = 4 };  /* one of these codes, steps, right-hand sides, events */

/* A run at a time: x, z and u, which holds the modes, are the values there. */
typedef struct {
    const Block *block;
    Problem problem;
    Watch watch;
    Switching switching;
    double t, due, x[NX + 1], z[NZ + 1], u[NU + 1];
    double *states, *unknowns, *inputs;
    long long next; /* output time to be written */
} BlockRun;

static inline void write_output(BlockRun *self, const double *x, const double *z,
                                const double *modes) {
    double *inputs = self->inputs + self->next * NU;
    memcpy(self->states + self->next * NX, x, NX * sizeof *x);
    memcpy(self->unknowns + self->next * NZ, z, NZ * sizeof *z);
    memcpy(inputs, self->u, NU * sizeof *inputs);
    memcpy(inputs + NU - MODES, modes, MODES * sizeof *modes);
    ++self->next;
}

static inline void write_present(BlockRun *self) {
    if (self->next < self->block->points && self->block->times[self->next] == self->t)
        write_output(self, self->x, self->z, self->u + NU - MODES);
}

static inline void plan_run(BlockRun *self, const Point *at) {
    const double stop = self->block->times[self->block->points - 1];
    plan(&self->watch.laws, &self->switching, at, self->t, stop, true, NEVER_AGAIN);
    self->due = next_until(&self->switching, stop);
}

/* Lets all happen that happens now. Returns 0 where the run goes on. */
static inline int let_happen(BlockRun *self, int crossing) {
    Watch *watch = &self->watch;
    double x[NX + 1], z[NZ + 1], u[NU + 1];
    const bool later[MODES + 1] = {0};
    const Point before = {self->t, x, z, u}, at = {self->t, self->x, self->z, self->u};
    Happening found;
    bool replan;
    if (watch->records == watch->last_record) return 1;
    memcpy(x, self->x, sizeof x);
    memcpy(z, self->z, sizeof z);
    memcpy(u, self->u, sizeof u);
    happen(&watch->laws, watch->switching, &at, self->x, crossing, later, NULL, &found, &replan);
    if (found.ending.reason != GOES_ON || is_sliding(watch->switching)) return 1;
    record_event(watch, &before, &at, &found);
    if (replan) plan_run(self, &at);
    write_present(self);
    return 0;
}

static inline int begin_run(BlockRun *self) {
    const Point at = {self->t, self->x, self->z, self->u};
    const Laws *laws = &self->watch.laws;
    Switching *switching = &self->switching;
    if (begin_modes(laws, switching, &at, self->block->span).reason != GOES_ON ||
        begin_events(laws, switching, &at).reason != GOES_ON || is_sliding(switching))
        return 1;
    if (EVENTS > 0) return let_happen(self, -1);
    plan_run(self, &at);
    write_present(self);
    return 0;
}

/* Boundaries that an event has displaced are back if the piece ends within them. */
static inline void let_go_at_end(BlockRun *self) {
    double z[NZ + 1];
    const Point at = {self->t, self->x, z, self->u};
    Seen seen = {.arguments = {0}};
    memcpy(z, self->z, sizeof z);
    if (any_leaves(&self->switching) && law_see(&self->watch.owner, &at, &seen))
        note_inside(&self->watch.laws, &self->switching, self->u + NU - MODES, seen.arguments);
}

/* Integrates to the next time event or the end. Returns 0 where the run goes on, -1 where the
 * solver fails. */
static inline int advance_run(BlockRun *self) {
    const Block *block = self->block;
    const double *grid = block->times, stop = grid[block->points - 1];
    double *times = block->work, *rows = times + block->points + 1;
    double *unknowns = rows + (block->points + 1) * NX, due = self->due;
    const double *record = self->watch.records;
    long long n = 0, row = self->next;
    while (row < block->points && grid[row] < due) ++row;
    /* only rounding is between them */
    if (row > self->next && due - grid[row - 1] <= 8 * ulp(grid[row - 1])) due = grid[row - 1];
    const double end = fmin(due, stop);
    times[n++] = self->t;
    for (row = self->next; grid[row] < end; ++row) times[n++] = grid[row];
    times[n++] = end;
    /* no solver begins with an output time so near, and the state is the same there */
    for (; n > 1 && !(times[1] > self->t + SAME_INSTANT * ulp(self->t)); ++times, --n) {
        if (n > 2) write_output(self, self->x, self->z, self->u + NU - MODES);
        times[1] = self->t;
    }
    if (n == 1 && block->watches) return 1;

    const Grid piece = {times, n, block->largest};
    Course course = {self->t, 0, 1};
    memcpy(rows, self->x, NX * sizeof *rows);
    memcpy(unknowns, self->z, NZ * sizeof *unknowns);
    const int code =
        n > 1 ? solver.integrate(&self->problem, &piece, rows, NZ > 0 ? unknowns : NULL, &course)
              : SUCCESS;
    if (code != SUCCESS) return code == EVENT ? 1 : -1;
    for (int i = 0; i < NX && record == self->watch.records; ++i)
        for (long long k = 0; k < n && block->constant[i] > 0; ++k) rows[k * NX + i] = self->x[i];
    for (long long k = 1; k < n - 1; ++k) {
        while (record < self->watch.records && record[0] <= times[k]) record += RECORD;
        write_output(self, rows + k * NX, unknowns + k * NZ,
                     record < self->watch.records ? record + 1 + NX + NZ : self->u + NU - MODES);
    }
    self->t = end;
    memcpy(self->x, rows + (n - 1) * NX, NX * sizeof *rows);
    memcpy(self->z, unknowns + (n - 1) * NZ, NZ * sizeof *rows);
    let_go_at_end(self);
    if (end == due) return let_happen(self, -1);
    const Point at = {self->t, self->x, self->z, self->u};
    Place place;
    const int leaving = margins_at(&self->watch.laws, &self->switching, &at, &place)
                            ? leaving_at(&self->switching, &place)
                            : -1;
    if (leaving >= 0) return let_happen(self, leaving);
    write_present(self);
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
            .watch = {.records = records, .last_record = last},
            .t = block->times[0],
            .due = INFINITY,
            .states = block->states + i * block->points * NX,
            .unknowns = block->unknowns + i * block->points * NZ,
            .inputs = block->inputs + i * block->points * NU,
        };
        self.problem.z = self.z;
        self.problem.u = self.u;
        if (block->watches) self.problem.watch = &self.watch;
        self.watch.switching = &self.switching;
        link_to_model(&self.problem, &self.watch, block->sizes + i * NX, arg, res, iw, w);
        memcpy(self.x, block->x + i * NX, NX * sizeof *self.x);
        memcpy(self.z, block->z + i * NZ, NZ * sizeof *self.z);
        memcpy(self.u, block->u + i * NU, NU * sizeof *self.u);
        int left = begin_run(&self);
        while (!left && self.next < block->points) left = advance_run(&self);
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
