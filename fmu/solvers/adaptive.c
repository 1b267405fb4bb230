/* The explicit Runge-Kutta pair of dop853.h, whose text stands before this one, over a grid. */
static double scale(const Task *task, int i, double x) {
    (void)i;
    return task->absolute + task->relative * fabs(x);
}

/* Integrates x over the grid; `out` takes a column per output time. Returns one of the codes. */
static int integrate(
    Problem *self, const Task *task, double *out, double *z, double *reached, double *last
) {
    Slopes k;
    Interpolant piece;
    double x[NX], end[NX], t = task->grid[0];
    const double stop = task->grid[task->points - 1];
    long long next = 1, trials = 0;
    int rejected = 0;
    memcpy(x, out, sizeof x);
    *reached = t;
    *last = 0;
    if (slope(self, t, x, k[0], z) || !is_finite(k[0])) return NOT_FINITE;
    double h = fmin(first_step(self, task, t, stop - t, x, k), task->largest);
    while (next < task->points) {
        *reached = t;
        *last = h;
        if (halted) return HALTED;
        if (++trials > MOST_STEPS) return TOO_MANY_STEPS;
        if (0.1 * h <= fabs(t) * DBL_EPSILON || h < 1e-18 * (stop - task->grid[0]))
            return STEP_TOO_SMALL;
        const int final = t + 1.01 * h >= stop;
        if (final) h = stop - t;
        const int lost = stages(self, t, h, x, k, end);
        const double error = lost ? NAN : error_of(task, h, x, end, k);
        const double after = final ? stop : t + h;
        if (!(error <= 1) || restore(self, end) || slope(self, after, end, k[END], NULL) ||
            !is_finite(k[END])) {
            h *= error > 1 ? growth(error, rejected) : 0.1;
            rejected = 1;
            continue;
        }
        ++self->steps;
        if (task->grid[next] < after && interpolate(self, t, h, x, end, k, &piece))
            return NOT_FINITE;
        for (; next < task->points && task->grid[next] <= after; ++next, trials = 0) {
            double *column = out + next * NX;
            if (task->grid[next] < after) {
                evaluate(&piece, task->grid[next], column);
                if (restore(self, column)) return NOT_FINITE;
            } else {
                memcpy(column, end, sizeof end);
            }
            if (z && slope(self, task->grid[next], column, k[1], z + next * NZ))
                return NOT_FINITE;
        }
        memcpy(x, end, sizeof x);
        memcpy(k[0], k[END], sizeof k[0]);
        t = after;
        h = fmin(h * growth(error, rejected), task->largest);
        rejected = 0;
    }
    *reached = t;
    return SUCCESS;
}
