/* Initial values of many runs, by `model_start` of one, whose sizes are START_ARG ... START_W. */
CASADI_SYMBOL_EXPORT void lanes_start(long long runs, double t, double *x, const double *u,
                                      const double *p, double *defect) {
    const double *arg[START_ARG];
    double *res[START_RES], w[START_W], solved[NX];
    casadi_int iw[START_IW];
    for (long long run = 0; run < runs; ++run, x += NX, u += NU, p += NP) {
        arg[0] = &t;
        arg[1] = x;
        arg[2] = u;
        arg[3] = p;
        res[0] = solved;
        res[1] = defect + run;
        if (model_start(arg, res, iw, w, 0)) defect[run] = 1;
        for (int i = 0; i < NX; ++i) x[i] = solved[i];
    }
}
