/* Explicit Runge-Kutta method with steps of one size within each output interval.
 *
 * Generated text stands before this one: STAGES, node[], and the weighted sums of the slopes
 * stage_sum(stage, k, sum); sum STAGES is that of the step.
 */
static int integrate(
    Problem *self, const Task *task, double *out, double *z, double *reached, double *last
) {
    double k[STAGES][NX], sum[NX], x[NX], y[NX];
    memcpy(x, out, sizeof x);
    if (z && slope(self, task->grid[0], x, k[0], z)) return NOT_FINITE;
    for (long long next = 1; next < task->points; ++next) {
        const double begin = task->grid[next - 1], length = task->grid[next] - begin;
        const double parts = fmax(1, ceil(length / task->largest * (1 - 1e-12)));
        const double h = length / parts;
        *last = h;
        for (double part = 0; part < parts; ++part) {
            const double t = begin + part * h;
            *reached = t;
            if (halted) return HALTED;
            for (int s = 0; s < STAGES; ++s) {
                stage_sum(s, (const double(*)[NX])k, sum);
                for (int i = 0; i < NX; ++i) y[i] = x[i] + h * sum[i];
                if (slope(self, t + node[s] * h, y, k[s], NULL)) return NOT_FINITE;
            }
            stage_sum(STAGES, (const double(*)[NX])k, sum);
            for (int i = 0; i < NX; ++i) x[i] += h * sum[i];
            if (restore(self, x)) return NOT_FINITE;
            ++self->steps;
        }
        if (!is_finite(x)) return NOT_FINITE;
        memcpy(out + next * NX, x, sizeof x);
        if (z && slope(self, task->grid[next], x, k[0], z + next * NZ)) return NOT_FINITE;
    }
    *reached = task->grid[task->points - 1];
    return SUCCESS;
}
