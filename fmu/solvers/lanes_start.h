/* Initial values of many runs, by `model_start` of one. */
#ifndef LANES_START_H
#define LANES_START_H

#include "lanes.h"

#if !defined NX || !defined NU || !defined NP || !defined START_ARG || !defined START_RES ||       \
    !defined START_IW || !defined START_W
#error "define NX, NU, NP, and the sizes that model_start needs, START_ARG to START_W"
#endif

/* Generated: start values and their defect; not 0 if there are none. */
int model_start(const double **arg, double **res, long long int *iw, double *w, int memory);

LANES_SHARED void lanes_start(long long runs, double t, double *x, const double *u, const double *p,
                              double *defect) {
    const double *arg[START_ARG];
    double *res[START_RES], w[START_W], solved[NX];
    long long int iw[START_IW];
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

#endif
