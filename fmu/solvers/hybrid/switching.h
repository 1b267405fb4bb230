/* What past events leave for later ones. All of it is doubles: a copy of the bytes continues a run.
 */
#ifndef HYBRID_SWITCHING_H
#define HYBRID_SWITCHING_H

#include "bounds.h"
#include "laws.h"

/* States of a relation. */
enum {
    FREE,
    LEAVES, /* it was 0 at its event, and has not been inside since */
    HELD,   /* it is 0 and stays so by definition, as what rests does */
    SLIDES  /* it stays 0 because its mode makes it so */
};

typedef struct {
    double state[MODES + 1];
    double beyond[MODES + 1]; /* argument of what is not free, which is 0 but for rounding, or for
                                 what an importer of model exchange steps too far */
    double left[MODES + 1];   /* the boundary that is displaced by it: of a floor, a whole number */
    double stays[MODES + 1];  /* rate up to which an argument that is held stays 0 */
    double slack[MODES + 1];  /* by which rounding moves an argument */
    double least[MODES + 1];  /* the same where states are as small as they are */
    double faint[MODES + 1];  /* rate up to which one is 0 but for rounding */
    double due[MODES + 1];    /* when a relation of time switches next: a time, NEVER, or JUMPS */
    double conditions[EVENTS + 1]; /* of rules, as they were after the last instant */
    double next;                   /* time event: the first of `due`; NOT_PLANNED after a change */
    double last;                   /* time of the last event */
    double reached;                /* by the last time event, to which an importer may be early */
    double start;
    double rounded; /* how often times and states were rounded: at events and in steps */
    double looked;  /* time at which an importer has looked last */
    double close;   /* events in succession that were close to each other */
    double span;    /* length of the run, or of the experiment where no end is known */
    double stopped; /* 1: an event has ended the run */
    double waits;   /* 1: a time event waits for the importer; 2 + i: a crossing of relation i */
} Switching;

enum { SWITCHING_SIZE = sizeof(Switching) / sizeof(double) };

_Static_assert(sizeof(Switching) == SWITCHING_SIZE * sizeof(double), "all of it is doubles");

#define NEVER_AGAIN DBL_MAX
#define NOT_PLANNED (-DBL_MAX)
#define JUMPS NOT_PLANNED /* due at the next time event, where its value tells its mode */

static const double ROUNDING = 64 * DBL_EPSILON; /* relative size of a number that is 0 */
static const double SAME_TIME = 1e-9; /* relative distance of times that importers take as one */
static const double SHARE_OF_WAIT = 1e-3; /* for an event that may be rounding of its time */

/* What differences of times are measured by: 1 s, a shorter run, or the time itself. */
static inline double time_scale(const Switching *s, double t) {
    return fmax(s->span > 0 ? fmin(1, s->span) : 1, fabs(t));
}

/* What rounding of a time is relative to: the largest one on the way to it. */
static inline double largest_time(const Switching *s, double t) {
    return fmax(fabs(s->start), fabs(t));
}

/* Notes steps of a solver, which rounds its own time, that since the start, so often in each. */
static inline void note_steps(Switching *s, double t, double roundings) {
    s->rounded += roundings * fmin(1, time_scale(s, t - s->start) / time_scale(s, t));
}

/* Relative distance of times that may be one, as rounding of events adds up: no more than a small
 * share of the time between two of them. */
static inline double located(const Switching *s, double t) {
    const double between = SHARE_OF_WAIT * (t - s->last) / time_scale(s, t);
    return fmin(LOCATED + fmin(s->rounded * DBL_EPSILON, fmax(between, 0)), SAME_TIME);
}

static inline double ulp(double t) {
    return nextafter(fabs(t), INFINITY) - fabs(t);
}

/* The time of an instant; importers of model exchange may come a little early to a time event, and
 * then to other events before its time. */
static inline double event_time(const Laws *laws, const Switching *s, double now) {
    const double known = SAME_TIME * fmax(fabs(now), fabs(s->next));
    const bool early = laws->blind && s->next != NOT_PLANNED && s->next > now &&
                       s->next - now <= fmax(known, ROUNDING * fabs(s->start));
    return early ? s->next : laws->blind ? fmax(now, s->reached) : now;
}

/* Whether a relation of time alone switches at a time. */
static inline bool is_due(const Switching *s, int i, double t) {
    return (s->due[i] == JUMPS ? s->next : s->due[i]) <= t + 8 * DBL_EPSILON * largest_time(s, t);
}

/* The next time event of a run that ends at a time, but for rounding; infinite: none. */
static inline double next_until(const Switching *s, double end) {
    const double rounding = 8 * ulp(largest_time(s, end));
    if (s->next > end + rounding) return INFINITY;
    return s->next < end - rounding ? s->next : end;
}

static inline bool any_is(const Switching *s, int state) {
    for (int i = 0; i < MODES; i++)
        if (s->state[i] == state) return true;
    return false;
}

static inline bool is_beyond(bool floor, double mode, double value) {
    return floor ? value < mode || value >= mode + 1 : mode * value < 0;
}

/* The argument of a relation of time alone at a time. */
static inline double timed_argument(const Laws *laws, const Point *at, int i, double t) {
    double arguments[MODES + 1], rates[MODES + 1];
    return laws->timed(laws->owner, at, t, arguments, rates) ? arguments[i] : NAN;
}

/* The value of an argument in excess of what was 0 at the last event; a floor has other boundaries,
 * which are where they are. */
static inline double past_boundary(const Laws *laws, const Switching *s, const Seen *seen, int i) {
    const double value = seen->arguments[i];
    return laws->relations[i].floor && fabs(value - s->left[i]) > 0.5 ? value
                                                                      : value - s->beyond[i];
}

#endif
