/* The noise of parts: by how much a step differs from two halves of it, however short it is.
 *
 * The error of a solver falls with the length of the step. What does not, such as results that are
 * rounded, keeps macro steps from being as accurate as they should be: a run hardly comes on.
 */
#ifndef NOISE_H
#define NOISE_H

#include "interface.h"

enum { LENGTHS = 4, WINDOW = 2000 }; /* tried, of one order of magnitude; attempts */

static const double HARDLY = 1e-3; /* progress, of the span */

/* Make steps of equal length from the saved state with constant inputs, and get the outputs.
 * Returns whether it has made them, without an event. */
static inline int make_steps(Coupling *self, Part *part, double length, int count, double *y) {
    double t = self->now.t;
    int made = !part_restore(&self->fmu, part) &&
               !part_set(&self->fmu, part, self->now.u + part->first_input);
    for (int i = 0; made && i < count; ++i, t += length)
        made = part_step(&self->fmu, part, t, length) == STEPPED;
    return made && !part_get(&self->fmu, part, y);
}

/* The difference of one step and two halves in the sizes of the inputs that the part drives. */
static inline double difference_of_halves(Coupling *self, Part *part, double length) {
    const System *system = self->system;
    double *whole = self->y + part->first_output, *halves = self->column, found = 0;
    if (!make_steps(self, part, length, 1, whole) || !make_steps(self, part, length / 2, 2, halves))
        return 0;
    for (long long k = 0; k < system->inputs; ++k) {
        const long long output = system->source[k] - part->first_output;
        if (system->held[k] || output < 0 || output >= part->outputs) continue;
        const double off = system->factor[k] * (whole[output] - halves[output]);
        const double size = size_of(system, k, self->now.u[k]);
        found = fmax(found, fabs(off) / size);
    }
    return found;
}

/* The noise of a part whose saved state is the present one. A part that rounds a short step away
 * has no difference there, which says nothing. */
static inline double noise_of(Coupling *self, Part *part, double length) {
    double noise = INFINITY;
    for (int scale = 0; scale < 3; ++scale, length /= 10) {
        double largest_of_scale = 0;
        for (int i = 0; i < LENGTHS; ++i) {
            const double one = difference_of_halves(self, part, length * (1 - 0.1 * i));
            largest_of_scale = fmax(largest_of_scale, one);
        }
        if (largest_of_scale > 0) noise = fmin(noise, largest_of_scale);
    }
    return isfinite(noise) ? noise : 0;
}

/* Whether a part has more noise than is allowed. All stay in their saved states. */
static inline int is_noisy(Coupling *self, double length, double allowed) {
    System *system = self->system;
    if (!self->all_roll_back || system->quantum > 0) return 0;
    double worst = allowed;
    for (long long p = 0; p < system->n_parts; ++p) {
        Part *part = system->parts + p;
        const long long steps = part->steps;
        const double noise = part->outputs ? noise_of(self, part, length) : 0;
        part_restore(&self->fmu, part);
        part->steps = steps;
        if (!(noise > worst)) continue;
        worst = system->noise = noise;
        system->part = p;
    }
    return worst > allowed;
}

/* Note an attempt; tells whether it completes a window in which the run hardly comes on. */
static inline int hardly_advances(const Coupling *self, Attempts *window, int rejected) {
    const double span = self->system->stop - self->system->start;
    if (window->made == 0) *window = (Attempts){.begin = self->now.t};
    window->rejected += rejected;
    if (++window->made < WINDOW) return 0;
    window->made = 0;
    return self->now.t - window->begin < HARDLY * span;
}

#endif
