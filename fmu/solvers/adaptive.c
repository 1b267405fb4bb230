/* Explicit Runge-Kutta pair of order 8(5,3) with dense output and step size control.
 *
 * Source  Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993,
 *         sections II.4 (starting step, control) and II.10 (error estimate, interpolant).
 *
 * Generated text stands before this one: node[], and the weighted sums of the slopes
 * stage_sum(stage, k, sum), error_5(k, sum), error_3(k, sum) and dense_sum(row, k, sum).
 */
enum { STAGES = 12, END = STAGES, EXTENDED = 16 }; /* slope END is that at the end of the step */

typedef double Slopes[EXTENDED][NX];

/* The interpolant of one step from t over h, in Hairer's nested form. */
typedef struct {
    double t, h;
    double row[8][NX];
} Interpolant;

static double scale(const Task *task, double x) {
    return task->absolute + task->relative * fabs(x);
}

static double norm(const Task *task, const double *values, const double *x) {
    double sum = 0;
    for (int i = 0; i < NX; ++i) {
        const double ratio = values[i] / scale(task, x[i]);
        sum += ratio * ratio;
    }
    return sqrt(sum / NX);
}

/* A step over which the error of order 8 is about the tolerance, from two derivatives. */
static double first_step(Problem *self, const Task *task, double t, const double *x, Slopes k) {
    const double span = task->grid[task->points - 1] - t;
    const double size = norm(task, x, x), rate = norm(task, k[0], x);
    double h = size > 1e-5 && rate > 1e-5 ? 0.01 * size / rate : 1e-6;
    double y[NX], change[NX];
    h = fmin(h, span);
    for (int i = 0; i < NX; ++i) y[i] = x[i] + h * k[0][i];
    if (slope(self, t + h, y, k[1], NULL) || !all_finite(k[1])) return h;
    for (int i = 0; i < NX; ++i) change[i] = k[1][i] - k[0][i];
    const double steepest = fmax(rate, norm(task, change, x) / h);
    const double next = steepest > 1e-15 ? pow(0.01 / steepest, 1.0 / 8) : fmax(1e-6, 1e-3 * h);
    return fmin(fmin(100 * h, next), fmin(span, task->largest));
}

/* The slopes of one step and the state at its end. Returns 0 where all of them have values. */
static int stages(Problem *self, double t, double h, const double *x, Slopes k, double *end) {
    double sum[NX];
    for (int s = 1; s <= END; ++s) {
        stage_sum(s, (const double(*)[NX])k, sum);
        for (int i = 0; i < NX; ++i) end[i] = x[i] + h * sum[i];
        if (s == END) break; /* the slope there is found once the step is accepted */
        if (slope(self, t + node[s] * h, end, k[s], NULL)) return 1;
    }
    return !all_finite(end);
}

/* Error of a step in units of the tolerance. */
static double error_of(const Task *task, double h, const double *x, const double *end, Slopes k) {
    double fifth[NX], third[NX], sum_5 = 0, sum_3 = 0;
    error_5((const double(*)[NX])k, fifth);
    error_3((const double(*)[NX])k, third);
    for (int i = 0; i < NX; ++i) {
        const double unit = scale(task, fmax(fabs(x[i]), fabs(end[i])));
        sum_5 += (fifth[i] / unit) * (fifth[i] / unit);
        sum_3 += (third[i] / unit) * (third[i] / unit);
    }
    const double both = sum_5 + 0.01 * sum_3;
    return both > 0 ? fabs(h) * sum_5 / sqrt(NX * both) : 0 * both; /* nan stays nan */
}

static int interpolate(
    Problem *self, double t, double h, const double *x, const double *end, Slopes k, Interpolant *p
) {
    double sum[NX], y[NX];
    for (int s = END + 1; s < EXTENDED; ++s) {
        stage_sum(s, (const double(*)[NX])k, sum);
        for (int i = 0; i < NX; ++i) y[i] = x[i] + h * sum[i];
        if (slope(self, t + node[s] * h, y, k[s], NULL)) return 1;
    }
    p->t = t;
    p->h = h;
    for (int i = 0; i < NX; ++i) {
        const double change = end[i] - x[i], bend = h * k[0][i] - change;
        p->row[0][i] = x[i];
        p->row[1][i] = change;
        p->row[2][i] = bend;
        p->row[3][i] = change - h * k[END][i] - bend;
    }
    for (int j = 0; j < 4; ++j) {
        dense_sum(j, (const double(*)[NX])k, sum);
        for (int i = 0; i < NX; ++i) p->row[4 + j][i] = h * sum[i];
    }
    return 0;
}

static void evaluate(const Interpolant *p, double t, double *x) {
    const double s = (t - p->t) / p->h, r = 1 - s;
    for (int i = 0; i < NX; ++i) {
        double value = p->row[7][i];
        for (int j = 6; j >= 0; --j) value = p->row[j][i] + (j % 2 ? r : s) * value;
        x[i] = value;
    }
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
    if (slope(self, t, x, k[0], z) || !all_finite(k[0])) return NOT_FINITE;
    double h = first_step(self, task, t, x, k);
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
        const double factor = 0.9 * pow(error, -1.0 / 8);
        const double after = final ? stop : t + h;
        if (!(error <= 1) || slope(self, after, end, k[END], NULL) || !all_finite(k[END])) {
            h *= error > 1 ? fmax(1.0 / 3, factor) : 0.1;
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
            } else {
                memcpy(column, end, sizeof end);
            }
            if (z && slope(self, task->grid[next], column, k[1], z + next * NZ))
                return NOT_FINITE;
        }
        memcpy(x, end, sizeof x);
        memcpy(k[0], k[END], sizeof k[0]);
        t = after;
        h = fmin(h * fmin(rejected ? 1.0 : 6.0, fmax(1.0 / 3, factor)), task->largest);
        rejected = 0;
    }
    *reached = t;
    return SUCCESS;
}
