/* Initial values of many runs, by `model_start` of one. */
#ifndef LANES_START_H
#define LANES_START_H

#include "lanes.h"

#if !defined NX || !defined NU || !defined NP || !defined WORK_ARG || !defined WORK_RES ||         \
    !defined WORK_IW || !defined WORK_W
#error "define NX, NU, NP, and the sizes that model_start needs, WORK_ARG to WORK_W"
#endif

/* Generated: start values and their defect; not 0 if there are none. */
int model_start(const double **arg, double **res, long long int *iw, double *w, int memory);

LANES_SHARED void lanes_start(long long runs, double t, double *x, const double *u, const double *p,
                              double *defect) {
    const double *arg[WORK_ARG + 1];
    double *res[WORK_RES + 1], w[WORK_W + 1], solved[NX];
    long long int iw[WORK_IW + 1];
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
