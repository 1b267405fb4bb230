/* Coordinate projection: moves a state to where the invariants of the model vanish.
 *
 * Source  Hairer & Wanner, Solving Ordinary Differential Equations II, 2nd ed. 1996, section VII.2.
 *
 * Generated text stands before this one: project(x, c) -> (x, change), a Newton step of least norm
 * and its size, and the sizes of its work space PROJECT_*.
 */
#define ROOT_OF_ROUNDING 1e-8 /* a Newton step of this size leaves an error of rounding */
#define MOST_CORRECTIONS 5

/* Returns 0 where it has succeeded. */
static int restore(const Problem *self, double *x) {
    const double *arg[PROJECT_ARG];
    double *res[PROJECT_RES], w[PROJECT_W], moved[NX], change = 0;
    long long iw[PROJECT_IW];
    for (int i = 0; i < MOST_CORRECTIONS; ++i) {
        arg[0] = x;
        arg[1] = self->c;
        res[0] = moved;
        res[1] = &change;
        if (project(arg, res, iw, w, 0) || !isfinite(change)) return 1;
        memcpy(x, moved, sizeof moved);
        if (change <= ROOT_OF_ROUNDING) return 0;
    }
    return 1;
}
