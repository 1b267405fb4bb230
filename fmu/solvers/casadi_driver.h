/* CasADi's own integrator, generated as `stepper` for some output times, as `run` of shapes.h for
 * any: its settings are the number of output times and how many of them it passes without a stop,
 * one where inputs change, all of them otherwise.
 */
#ifndef CASADI_DRIVER_H
#define CASADI_DRIVER_H

#include "shapes.h"

enum { STEPPER_RESULTS = 7 };

int stepper(const double **arg, double **res, long long *iw, double *w, int mem);
int stepper_work(long long *sz_arg, long long *sz_res, long long *sz_iw, long long *sz_w);

SHARED int run_work(long long *sz_arg, long long *sz_res, long long *sz_iw, long long *sz_w) {
    return stepper_work(sz_arg, sz_res, sz_iw, sz_w);
}

SHARED int run(const double **arg, double **res, long long *iw, double *w, int mem) {
    for (int i = 2; i < STEPPER_RESULTS; ++i) res[i] = NULL; /* quadratures, adjoints: none */
    return arg[2] ? stepper(arg, res, iw, w, mem) : 1;
}

#endif
