/* A solver as a function of CasADi's interface for external functions:
 *
 *     run(x0, z0, p, u) -> (xf, zf), one column per output time,
 *
 * p = (c, number of output times, of breaks and of columns of u, relative and absolute tolerance,
 * largest step, nominal values of the states, output times, breaks). At a break, the position of an
 * output time, a step ends and a fresh one begins. u has one column, or one per output time that
 * holds on the way there; where it changes is a break, too. None of these numbers is a constant of
 * the library: `cosim_sizes` must be called before CasADi asks for the sizes. A run that fails
 * leaves alone what it does not reach.
 */
#ifndef EXTERNAL_H
#define EXTERNAL_H

#if !defined WORK_ARG || !defined WORK_RES || !defined WORK_IW || !defined WORK_W
#error "define WORK_ARG, WORK_RES, WORK_IW and WORK_W, the work space of the generated functions"
#endif

#define SETTINGS (6 + NX)
#include "shapes.h"
#include "timed.h"

/* What the functions below run; generated code fills it. */
typedef struct {
    Equations *rhs, *project, *watch; /* NULL where there is none */
    Integrate *integrate;
} Solver;

static const Solver solver;

enum { REPORT = 9 };

static _Thread_local double report[REPORT];

/* What the thread's last run took and where it ended: steps, right-hand sides, Jacobians, code,
 * time, step size, how many output times it reached, the relation at whose crossing it ended or -1,
 * how many events it has recorded. */
SHARED void cosim_report(double *out) {
    memcpy(out, report, sizeof report);
}

static _Thread_local double *first_record, *switching;
static _Thread_local const double *sizes_of_states;
static _Thread_local double end_of_run;
static _Thread_local long long room;
static _Thread_local int leaves_stiff;

/* Where the thread's next runs record the events that they go through, and how many fit in there;
 * what past events have left; sizes of the states, in whose rounding an argument is 0; the time up
 * to which time events are planned; whether the runs end where they are found to be stiff. */
SHARED void cosim_prepare(double *rows, long long count, double *left, const double *sizes,
                          double end, int leaves) {
    first_record = rows;
    room = count;
    switching = left;
    sizes_of_states = sizes;
    end_of_run = end;
    leaves_stiff = leaves;
}

enum { OWN_ARGUMENTS = 4, OWN_RESULTS = 2 }; /* of `run`; they come first in the work space */

SHARED int run_work(long long *sz_arg, long long *sz_res, long long *sz_iw, long long *sz_w) {
    *sz_arg = OWN_ARGUMENTS + WORK_ARG;
    *sz_res = OWN_RESULTS + RESULTS_OF_A_LAW + WORK_RES; /* `call_law` writes them all */
    *sz_iw = WORK_IW;
    *sz_w = WORK_OF_LAWS;
    return 0;
}

/* Links a problem and what watches it to the model and to the caller's work space. */
static inline void link_to_model(Problem *problem, Watch *watch, const double *sizes,
                                 const double **arg, double **res, long long *iw, double *w) {
    problem->rhs = solver.rhs;
    problem->project = solver.project;
    problem->arg = arg + OWN_ARGUMENTS;
    problem->res = res + OWN_RESULTS;
    problem->iw = iw;
    problem->w = w;
    watch->problem = problem;
    watch->watch = solver.watch;
    watch->owner =
        (LawOwner){problem->c, sizes, NULL, problem->arg, problem->res, iw, w, NULL, NULL, NULL};
    watch->laws = laws_of_model(&watch->owner);
    watch->relation = -1;
}

/* Output times, positions of breaks among them, and inputs on the way to each of them. */
typedef struct {
    const double *times, *breaks, *u;
    long long points, number_of_breaks, columns;
} Schedule;

static inline const double *inputs_to(const Schedule *self, long long i) {
    return self->u + (self->columns > 1 ? i * NU : 0);
}

/* The position after `begin`, at most the last one, at which a fresh step has to begin. */
static inline long long next_break(const Schedule *self, long long begin) {
    long long end = self->points - 1;
    for (long long i = self->number_of_breaks - 1; i >= 0 && self->breaks[i] > (double)begin; --i)
        end = (long long)self->breaks[i];
    if (self->columns > 1)
        for (long long i = begin + 2; i <= end; ++i)
            if (memcmp(inputs_to(self, i), inputs_to(self, i - 1), NU * sizeof(double)))
                end = i - 1;
    return end;
}

/* Integrates from break to break. What the unknowns were before one is kept. */
static inline int integrate_pieces(Problem *self, Watch *watch, const Schedule *schedule,
                                   double largest, double *out, double *z, Course *course) {
    double x[NX];
    memcpy(x, out, sizeof x);
    for (long long begin = 0, end; begin < schedule->points - 1; begin = end) {
        end = next_break(schedule, begin);
        const Grid grid = {.begin = schedule->times[begin],
                           .end = schedule->times[end],
                           .times = schedule->times + begin + 1,
                           .points = end - begin,
                           .first = begin == 0 ? z : NULL,
                           .states = out + (begin + 1) * NX,
                           .unknowns = z ? z + (begin + 1) * NZ : NULL,
                           .largest = largest,
                           .turns = schedule->columns == 1 && end < schedule->points - 1};
        if (schedule->columns > 1)
            memcpy(self->u, inputs_to(schedule, begin + 1), NU * sizeof *self->u);
        const int code = integrate_timed(solver.integrate, self, watch, &grid, x, course);
        if (code == EVENT) { /* the state there follows the output times that were passed */
            double dx[NX], *const unknowns = z ? z + course->passed * NZ : NULL;
            memcpy(out + course->passed * NX, x, sizeof x);
            if (unknowns && equations_at(self, course->reached, x, dx, unknowns)) return NOT_FINITE;
        }
        if (code != SUCCESS) return code;
    }
    return SUCCESS;
}

SHARED int run(const double **arg, double **res, long long *iw, double *w, int mem) {
    static const double none[NX + NZ + NU + 1]; /* what is not given is 0 */
    const double *x0 = arg[0] ? arg[0] : none, *c = arg[2];
    (void)mem;
    if (!c || !res[0]) return 1;
    const double *settings = c + NC, *nominal = settings + 6, *times = nominal + NX;
    double z[NZ + 1], u[NU + 1];
    const long long points = (long long)settings[0];
    const int given = arg[3] != NULL;
    const Schedule schedule = {times,  times + points,         given ? arg[3] : none,
                               points, (long long)settings[1], given ? (long long)settings[2] : 1};
    Problem problem = {
        .z = z,
        .u = u,
        .c = c,
        .relative = settings[3],
        .absolute = settings[4],
        .nominal = nominal,
        .leaves_stiff = leaves_stiff,
    };
    Watch watch = {
        .switching = (Switching *)(void *)switching,
        .records = first_record,
        .last_record = schedule.columns > 1 ? first_record : first_record + room * RECORD,
        .until = end_of_run,
    };
    link_to_model(&problem, &watch, sizes_of_states, arg, res, iw, w);
    Watch *const events = solver.watch && switching ? &watch : NULL;
    if (events && has_states(&watch.laws)) problem.watch = events;
    memcpy(z, arg[1] ? arg[1] : none, NZ * sizeof *z);
    memcpy(u, schedule.u, NU * sizeof *u);
    Course course = {times[0], 0, 1};
    memcpy(res[0], x0, NX * sizeof *x0);
    const int code =
        integrate_pieces(&problem, events, &schedule, settings[5], res[0], res[1], &course);
    const long long recorded = (watch.records - first_record) / RECORD;
    const double seen[REPORT] = {(double)problem.steps,
                                 (double)problem.calls,
                                 0,
                                 code,
                                 course.reached,
                                 course.last,
                                 (double)course.passed,
                                 (double)watch.relation,
                                 (double)recorded};
    memcpy(report, seen, sizeof report);
    return code != SUCCESS;
}

#endif
