/* Outputs and limits of one run at all of its times, several times at once.
 *
 * Sines and cosines are those of the C library, so that the numbers are the bits of scalar code.
 */
#ifndef LANES_OUTPUTS_H
#define LANES_OUTPUTS_H

#include "lanes.h"

/* States, inputs, parameters, constants (what depends on parameters alone), outputs and margins. */
#if !defined NX || !defined NU || !defined NP || !defined NC || !defined NY
#error "define NX, NU, NP, NC and NY before solvers are included"
#endif

/* The model; generated code fills it. */
typedef struct {
    LaneFunction *constants; /* p -> c */
    LaneFunction *observe;   /* t, x, u, c -> y */
} LaneOutputs;

static const LaneOutputs outputs;

/* Writes a row of `stride` numbers per time; x and u have a row per time, too. */
LANES_SHARED void lanes_outputs(long long points, const double *t, const double *x, const double *u,
                                const double *p, double *rows, long long stride) {
    V time, c[NC + 1], now[NU + 1], numbers[NP + 1], state[NX], y[NY + 1];
    for (int i = 0; i < NP; ++i) numbers[i] = every(p[i]);
    const V *given[] = {numbers}, *in[] = {&time, state, now, c};
    V *constants[] = {c}, *out[] = {y};
    outputs.constants(given, constants);
    for (long long j = 0; j < points; j += LANES) {
        FOR_LANES {
            const long long k = j + l < points ? j + l : points - 1;
            time[l] = t[k];
            for (int i = 0; i < NX; ++i) state[i][l] = x[k * NX + i];
            for (int i = 0; i < NU; ++i) now[i][l] = u[k * NU + i];
        }
        outputs.observe(in, out);
        for (int l = 0; l < LANES && j + l < points; ++l)
            for (int i = 0; i < NY; ++i) rows[(j + l) * stride + i] = y[i][l];
    }
}

#endif
