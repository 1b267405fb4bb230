/* Inputs within a communication step: polynomials of the time since that of the instance. */
#ifndef INPUT_MOTION_H
#define INPUT_MOTION_H

#include <float.h>
#include <math.h>
#include <string.h>

#include "state.h"

/* A derivative of the polynomial of an input, by Horner's scheme from that of order 3 downward. */
static double derivative_at(const Instance *self, int input, int order, double since) {
    const State *state = &self->state;
    double sum = 0;
    for (int n = MOST_INPUT_ORDER; n > order; n--)
        sum = (sum + state->motion[n - 1][input]) * since / (n - order);
    return sum + (order > 0 ? state->motion[order - 1][input] : state->values[FIRST_INPUT + input]);
}

/* Those of all inputs; modes, which follow them, rest. */
static void derivatives_at(const Instance *self, int order, double time, double found[]) {
    const double *values = self->state.values, since = time - values[TIME];
    for (int i = 0; i < NU - MODES; i++) found[i] = derivative_at(self, i, order, since);
    for (int i = NU - MODES; i < NU; i++) found[i] = order > 0 ? 0 : values[FIRST_INPUT + i];
}

/* Values, and first derivatives, at a time. */
static void inputs_at(const Instance *self, double time, double u[]) {
    derivatives_at(self, 0, time, u);
}

static void input_slopes_at(const void *instance, double time, double du[]) {
    derivatives_at(instance, 1, time, du);
}

/* Bring values and derivatives to a time, which becomes that of the instance. */
static void move_inputs(Instance *self, double time) {
    double *values = self->state.values;
    const double since = time - values[TIME];
    if (since != 0) memset(self->state.departure, 0, sizeof self->state.departure);
    for (int i = 0; i < NU - MODES; i++) {
        values[FIRST_INPUT + i] = derivative_at(self, i, 0, since);
        for (int order = 1; order < MOST_INPUT_ORDER; order++)
            self->state.motion[order - 1][i] = derivative_at(self, i, order, since);
    }
    values[TIME] = time;
}

/* Whether an input that has these values within a step begins it at rest, and then leaves its value
   to one side. What it has moved by up to the first of them tells no slope, but by rounding. */
static bool departs(double first_way, double at_begin, double a, double b, double at_end) {
    const double tiny = 64 * DBL_EPSILON * fmax(fabs(at_begin), fabs(at_end));
    const double way = at_end - at_begin;
    return fabs(first_way) <= tiny && fabs(way) > tiny && (a - at_begin) * way > 0 &&
           (b - at_begin) * way > 0;
}

/* Ask the importer for the inputs at equidistant times up to an end; they then move on the
   polynomials through them. False where it has called what it must not. */
static bool ask_for_motion(Instance *self, double end) {
    double *now = self->state.values + FIRST_INPUT, u[MOST_INPUT_ORDER + 1][ROOM(NU)] = {{0}};
    const double begin = self->state.values[TIME], h = (end - begin) / MOST_INPUT_ORDER;
    for (int k = 0; k <= MOST_INPUT_ORDER; k++) {
        if (!self->host.ask_inputs(self, k < MOST_INPUT_ORDER ? begin + k * h : end)) return false;
        memcpy(u[k], now, NU * sizeof *now);
    }
    memcpy(now, u[0], NU * sizeof *now);
    if (!(h > 0)) return true;     /* rounding has left nothing of the step */
    for (int i = 0; i < NU; i++) { /* by forward differences, which are 0 where inputs rest */
        const double a = u[1][i] - u[0][i], b = u[2][i] - u[1][i], c = u[3][i] - u[2][i];
        const double second = b - a, third = c - b - second, first = a - second / 2 + third / 3;
        const bool departing = departs(first, u[0][i], u[1][i], u[2][i], u[3][i]);
        self->state.departure[i] = departing ? 2 * (a + b + c) / (9 * h * h) : 0;
        self->state.motion[0][i] = departing ? 0 : first / h;
        self->state.motion[1][i] = (second - third) / (h * h);
        self->state.motion[2][i] = third / (h * h * h);
    }
    return true;
}

static bool inputs_rest(const Instance *self) {
    for (int order = 0; order < MOST_INPUT_ORDER; order++)
        for (int i = 0; i < NU - MODES; i++)
            if (self->state.motion[order][i] != 0) return false;
    return true;
}

#endif
