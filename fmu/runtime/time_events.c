/* When relations of time alone switch next: exactly, if they are linear in time; otherwise searched
   for over the span of the model's experiment, and then anew; see time_search.c. */
#include "time_events.h"

#include <math.h>

#include "equations.h"
#include "evaluation.h"
#include "time_search.h"

#if HAS_EVENTS

enum { SEARCHED = 4096, SPAN = 50 }; /* places of a search; its length in largest steps */

void modes_of_time(Instance *self, double t, double modes[]) {
    double arguments[ROOM(N_MODES)], rates[ROOM(N_MODES)];
    evaluate_timed(self, t, arguments, rates);
    for (int i = 0; i < N_MODES; i++) {
        if (!relations[i].of_time || !isfinite(arguments[i])) continue;
        modes[i] = relations[i].floor ? floor(arguments[i]) : arguments[i] >= 0 ? 1 : -1;
    }
}

/* Where an argument `value + rate t` leaves its mode. */
static double linear_root(double mode, bool floor, double value, double rate, double now) {
    if (rate == 0 || (!floor && mode * rate > 0)) return NO_EVENT;
    const double boundary = !floor ? 0 : rate > 0 ? mode + 1 : mode;
    const double root = (boundary - value) / rate;
    return isfinite(root) ? fmax(root, nextafter(now, INFINITY)) : NO_EVENT;
}

static bool is_outside(Instance *self, int i, double t) {
    double arguments[ROOM(N_MODES)], rates[ROOM(N_MODES)];
    const double mode = self->state.values[FIRST_MODE + i];
    evaluate_timed(self, t, arguments, rates);
    const double value = arguments[i];
    return relations[i].floor ? value < mode || value >= mode + 1 : mode * value < 0;
}

static double searched_root(Instance *self, int i, double now, double end) {
    double low = now, high = NO_EVENT;
    for (int k = 1; k <= SEARCHED && high == NO_EVENT; k++) {
        const double t = now + (end - now) * k / SEARCHED;
        if (is_outside(self, i, t))
            high = t;
        else
            low = t;
    }
    if (high == NO_EVENT) return NO_EVENT;
    for (double t = low + (high - low) / 2; t > low && t < high; t = low + (high - low) / 2) {
        if (is_outside(self, i, t))
            high = t;
        else
            low = t;
    }
    return high;
}

static bool is_bounded(int i) {
#if N_BOUNDED > 0
    for (int k = 0; k < N_BOUNDED; k++)
        if (bounded[k] == i) return true;
#else
    (void)i;
#endif
    return false;
}

void plan_time_events(Instance *self, double now) {
    Switching *s = &self->state.switching;
    const double *modes = self->state.values + FIRST_MODE, stop = self->state.stop_time;
    const double far = now + SPAN * LARGEST_STEP, end = now < stop ? fmin(far, stop) : far;
    double values[ROOM(N_MODES)], rates[ROOM(N_MODES)];
    evaluate_timed(self, 0, values, rates);
    s->next = NO_EVENT;
    for (int i = 0; i < N_MODES; i++) {
        s->due[i] = NO_EVENT;
        if (!relations[i].of_time || is_bounded(i)) continue;
        s->due[i] = relations[i].linear
                        ? linear_root(modes[i], relations[i].floor, values[i], rates[i], now)
                        : searched_root(self, i, now, end);
        const bool further = !relations[i].linear && s->due[i] == NO_EVENT && end != stop;
        s->next = fmin(s->next, further ? end : s->due[i]);
        if (!relations[i].linear && s->due[i] != NO_EVENT) s->due[i] = JUMPS;
    }
#if N_PULSES > 0
    for (int k = 0; k < N_PULSES && pulses[k] < s->next; k++)
        if (pulses[k] > now + 4 * DBL_EPSILON * fabs(now)) s->next = pulses[k];
#endif
#if N_BOUNDED > 0
    const double until = fmin(s->next, end);
    const double first = search_bounded(self, now, until + 8 * DBL_EPSILON * fabs(until), s->due);
    s->next = fmin(s->next, first == NO_EVENT && end != stop ? end : first);
#endif
}

#else
typedef int no_time_events; /* C knows no empty file */
#endif
