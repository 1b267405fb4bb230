/* Explicit Runge-Kutta pair of order 8(5,3) with dense output: one step at a time.
 *
 * Source  Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993,
 *         sections II.4 (starting step, control) and II.10 (error estimate, interpolant).
 *
 * What includes this text has before it: NX; the types Problem and Task; slope(self, t, x, dx, z),
 * which returns 0 where dx/dt has a value; is_finite(x); and the generated node[] and weighted
 * sums of the slopes stage_sum(stage, k, sum), error_5(k, sum), error_3(k, sum) and
 * dense_sum(row, k, sum). It has to define scale.
 */
enum { STAGES = 12, END = STAGES, EXTENDED = 16 }; /* slope END is that at the end of the step */

typedef double Slopes[EXTENDED][NX];

/* The error that state i may have in a step where it is x. */
static double scale(const Task *task, int i, double x);

/* The interpolant of one step from t over h, in Hairer's nested form. */
typedef struct {
    double t, h;
    double row[8][NX];
} Interpolant;

static double norm(const Task *task, const double *values, const double *x) {
    double sum = 0;
    for (int i = 0; i < NX; ++i) {
        const double ratio = values[i] / scale(task, i, x[i]);
        sum += ratio * ratio;
    }
    return sqrt(sum / NX);
}

/* A step over which the error of order 8 is about the tolerance, from two derivatives. */
static double first_step(
    Problem *self, const Task *task, double t, double span, const double *x, Slopes k
) {
    const double size = norm(task, x, x), rate = norm(task, k[0], x);
    double h = size > 1e-5 && rate > 1e-5 ? 0.01 * size / rate : 1e-6;
    double y[NX], change[NX];
    h = fmin(h, span);
    for (int i = 0; i < NX; ++i) y[i] = x[i] + h * k[0][i];
    if (slope(self, t + h, y, k[1], NULL) || !is_finite(k[1])) return h;
    for (int i = 0; i < NX; ++i) change[i] = k[1][i] - k[0][i];
    const double steepest = fmax(rate, norm(task, change, x) / h);
    const double next = steepest > 1e-15 ? pow(0.01 / steepest, 1.0 / 8) : fmax(1e-6, 1e-3 * h);
    return fmin(fmin(100 * h, next), span);
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
    return !is_finite(end);
}

/* Error of a step in units of the tolerance. */
static double error_of(const Task *task, double h, const double *x, const double *end, Slopes k) {
    double fifth[NX], third[NX], sum_5 = 0, sum_3 = 0;
    error_5((const double(*)[NX])k, fifth);
    error_3((const double(*)[NX])k, third);
    for (int i = 0; i < NX; ++i) {
        const double unit = scale(task, i, fmax(fabs(x[i]), fabs(end[i])));
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

/* What the size of a step is multiplied by after an error. */
static double growth(double error, int rejected) {
    const double most = error > 1 || rejected ? 1.0 : 6.0;
    return fmin(most, fmax(1.0 / 3, 0.9 * pow(error, -1.0 / 8)));
}
