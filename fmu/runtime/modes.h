/* Modes of relations: which ones are consistent at an instant. Without HAS_EVENTS there are none.
 */
#ifndef MODES_H
#define MODES_H

#include "state.h"
#include "visibility.h"

#if HAS_EVENTS
#include <float.h>

#define NO_EVENT DBL_MAX
#define NOT_PLANNED (-DBL_MAX)
#define JUMPS NOT_PLANNED /* due at the next time event, where its value tells its mode */

enum { MOST_ROUNDS = 100 }; /* of event iteration at one instant */

/* A point of a motion; the modes in `u` that slide, and z from its guess, are found. */
typedef struct {
    double t;
    const double *x;
    double *z, *u;
} Point;

/* Arguments of the relations, their time derivatives, and sizes of the first of these. */
typedef struct {
    double arguments[ROOM(N_MODES)], rates[ROOM(N_MODES)], seconds[ROOM(N_MODES)],
        sizes[ROOM(N_MODES)];
} Seen;

INSIDE_BEGIN

/* The relations at the present values; how far arguments are within modes, and the rates of that.
 */
Status watch_relations(Instance *self, Seen *seen);
void measure(const Instance *self, const double modes[], const Seen *seen, double inside[],
             double rates[]);

/* Whether the argument of relation i has stayed 0 since its last event. */
bool is_held(const Instance *self, const Seen *seen, int i);

/* Whether an input has moved an argument away that was 0, which no equation tells. */
bool is_moved(const Instance *self, const Seen *seen, int i);

/* Refuses, where a relation slides, inputs that move its argument. */
Status look_at_slides(Instance *self, Status severity);

/* How far each relation is within its mode; false where there is no value. */
bool inside_at(Instance *self, const Point *at, double inside[], double rates[]);

/* The same at the present values for those that are watched, which are not of time alone. */
Status get_insides(Instance *self, double inside[]);

/* Set the modes of relations that slide; false where there are none that keep their arguments. */
bool follow(Instance *self, const Point *at);
Status follow_present(Instance *self);
bool is_sliding(const Instance *self);

/* The modes of the start values; consistent modes at an instant. */
Status begin_modes(Instance *self);
Status settle_modes(Instance *self, bool zero[], const bool decided[], Status severity);

/* Relative size of a rate that is 0. */
static const double ROUNDING = 64 * DBL_EPSILON;

/* Relative distance of times that importers take as one. */
static const double SAME_TIME = 1e-9;

/* The present time; importers may come a little early to a time event. */
double event_time(const Instance *self);

/* Arguments of time alone, and their rates; not a number where they have no value. */
void evaluate_timed(Instance *self, double t, double arguments[], double rates[]);

INSIDE_END
#else
static inline Status begin_modes(Instance *self) {
    (void)self;
    return OK;
}
static inline Status follow_present(Instance *self) {
    (void)self;
    return OK;
}
static inline Status look_at_slides(Instance *self, Status severity) {
    (void)self, (void)severity;
    return OK;
}
static inline Status get_insides(Instance *self, double inside[]) {
    (void)self, (void)inside;
    return OK;
}
static inline bool is_sliding(const Instance *self) {
    (void)self;
    return false;
}
#endif

#endif
