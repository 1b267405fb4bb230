/* A solver as a function of CasADi's interface for external functions:
 *
 *     run(x0, z0, p, u) -> (xf, zf), one column per output time,
 *
 * p = (c, number of output times, relative and absolute tolerance, largest step, output times).
 * How many output times there are is no constant of the library: `cosim_points` must be called
 * before CasADi asks for the sizes.
 */
#ifndef EXTERNAL_H
#define EXTERNAL_H

#include "interrupt.h"
#include "problem.h"

/* What the functions below run; generated code fills it. */
typedef struct {
    Equations *rhs, *project;
    WorkSize *rhs_work, *project_work; /* the latter NULL without the former */
    int (*integrate)(Problem *self, const Grid *grid, double *out, double *z, Course *course);
} Solver;

static const Solver solver;

enum { SETTINGS = 4, REPORT = 6 };

static _Thread_local double report[REPORT];
static long long size_x0[3] = {NX, 1, 1}, size_z0[3] = {NZ, 1, 1}, size_u[3] = {NU, 1, 1};
static long long size_p[3] = {0, 1, 1}, size_xf[3] = {NX, 0, 1}, size_zf[3] = {NZ, 0, 1};

SHARED void cosim_points(long long points) {
    size_p[0] = NC + SETTINGS + points;
    size_xf[1] = points;
    size_zf[1] = points;
}

/* What the thread's last run took and where it ended: steps, right-hand sides, Jacobians, code,
 * time, step size. */
SHARED void cosim_report(double *out) {
    memcpy(out, report, sizeof report);
}

SHARED long long run_n_in(void) {
    return 4;
}
SHARED long long run_n_out(void) {
    return 2;
}

SHARED const char *run_name_in(long long i) {
    static const char *const names[] = {"x0", "z0", "p", "u"};
    return i >= 0 && i < 4 ? names[i] : NULL;
}

SHARED const char *run_name_out(long long i) {
    return i == 0 ? "xf" : i == 1 ? "zf" : NULL;
}

SHARED const long long *run_sparsity_in(long long i) {
    const long long *const sizes[] = {size_x0, size_z0, size_p, size_u};
    return i >= 0 && i < 4 ? sizes[i] : NULL;
}

SHARED const long long *run_sparsity_out(long long i) {
    return i == 0 ? size_xf : i == 1 ? size_zf : NULL;
}

static inline void widen(long long *size, long long wanted) {
    if (wanted > *size) *size = wanted;
}

SHARED int run_work(long long *sz_arg, long long *sz_res, long long *sz_iw, long long *sz_w) {
    long long arg = 0, res = 0, iw = 0, w = 0;
    int failed = solver.rhs_work(sz_arg, sz_res, sz_iw, sz_w);
    if (solver.project_work) failed |= solver.project_work(&arg, &res, &iw, &w);
    widen(sz_arg, arg);
    widen(sz_res, res);
    widen(sz_iw, iw);
    widen(sz_w, w);
    *sz_arg += 4; /* ours come first */
    *sz_res += 2;
    return failed;
}

SHARED int run(const double **arg, double **res, long long *iw, double *w, int mem) {
    static const double none[NX + NZ + NU + 1]; /* what is not given is 0 */
    const double *x0 = arg[0] ? arg[0] : none, *c = arg[2];
    (void)mem;
    if (!c || !res[0]) return 1;
    const double *settings = c + NC;
    const Grid grid = {settings + SETTINGS, (long long)settings[0], settings[3]};
    Problem problem = {
        .rhs = solver.rhs,
        .project = solver.project,
        .z = arg[1] ? arg[1] : none,
        .u = arg[3] ? arg[3] : none,
        .c = c,
        .arg = arg + 4,
        .res = res + 2,
        .iw = iw,
        .w = w,
        .relative = settings[1],
        .absolute = settings[2],
    };
    Course course = {grid.times[0], 0};
    memcpy(res[0], x0, NX * sizeof *x0);
    const int code = solver.integrate(&problem, &grid, res[0], res[1], &course);
    const double seen[REPORT] = {
        (double)problem.steps, (double)problem.calls, 0, code, course.reached, course.last};
    memcpy(report, seen, sizeof report);
    return code != SUCCESS;
}

#endif
