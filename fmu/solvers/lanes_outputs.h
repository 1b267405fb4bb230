/* What a run records, and the margins of its limits, several times at once.
 *
 * Sines and cosines are those of the C library, so that the numbers are the bits of scalar code.
 */
#ifndef LANES_OUTPUTS_H
#define LANES_OUTPUTS_H

#include "lanes.h"

/* States, inputs, parameters, constants (what depends on parameters alone), outputs and limits. */
#if !defined NX || !defined NU || !defined NP || !defined NC || !defined NY || !defined NL
#error "define NX, NU, NP, NC, NY and NL before solvers are included"
#endif

/* The model; generated code fills it. */
typedef struct {
    LaneFunction *constants; /* p -> c */
    LaneFunction *observe;   /* t, x, u, c -> outputs and margins of the limits */
} LaneOutputs;

static const LaneOutputs outputs;

/* A run and its requested outputs. */
typedef struct {
    long long points, columns; /* times; rows of u: 1 that holds throughout, or one per time */
    const double *t, *x, *u, *p;
    long long recorded;
    const long long *places; /* of what is recorded, among states and outputs */
    double *rows;            /* takes a row of these per time */
    long long *first;        /* see below */
    double *margins;         /* takes a row of those of the limits per time; or NULL */
} Watched;

/* Fills the rows. `first` takes the position of the first time at which a state, or what is
 * recorded, is not finite; the number of times if there is none. */
LANES_SHARED void lanes_outputs(const Watched *self) {
    const long long points = self->points;
    V time, c[NC + 1], now[NU + 1], numbers[NP + 1], known[NX + NY + NL + 1];
    for (int i = 0; i < NP; ++i) numbers[i] = every(self->p[i]);
    const V *given[] = {numbers}, *in[] = {&time, known, now, c};
    V *constants[] = {c}, *out[] = {known + NX};
    outputs.constants(given, constants);
    *self->first = points;
    for (long long j = 0; j < points; j += LANES) {
        FOR_LANES {
            const long long k = j + l < points ? j + l : points - 1;
            const double *u = self->u + (self->columns > 1 ? k * NU : 0);
            time[l] = self->t[k];
            for (int i = 0; i < NX; ++i) known[i][l] = self->x[k * NX + i];
            for (int i = 0; i < NU; ++i) now[i][l] = u[i];
        }
        outputs.observe(in, out);
        V sum = every(0); /* 0 * inf and 0 * nan are nan */
        for (int i = 0; i < NX; ++i) sum += 0 * known[i];
        for (long long i = 0; i < self->recorded; ++i) sum += 0 * known[self->places[i]];
        const M lost = ~(sum == 0);
        for (int l = 0; l < LANES && *self->first == points; ++l)
            if (lost[l]) *self->first = j + l < points ? j + l : points - 1;
        for (int l = 0; l < LANES && j + l < points; ++l) {
            double *const row = self->rows + (j + l) * self->recorded;
            double *const margins = self->margins ? self->margins + (j + l) * NL : NULL;
            for (long long i = 0; i < self->recorded; ++i) row[i] = known[self->places[i]][l];
            for (int i = 0; i < NL && margins; ++i) margins[i] = known[NX + NY + i][l];
        }
    }
}

#endif
