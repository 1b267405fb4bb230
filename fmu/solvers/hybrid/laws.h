/* What a model tells the kernel of events: its relations, its rules, and functions to evaluate
 * both.
 *
 * A relation has an argument and a mode: the sign of the argument, or its floor. Between events the
 * equations are used with modes that do not change. A rule is an event that the author declared: it
 * happens when its condition rises, and assigns new values to states.
 *
 * The kernel knows no model. Its sizes are macros: NX states, NZ algebraic unknowns, NU inputs of
 * which the last MODES are modes, EVENTS rules with ASSIGNED assignments in all, DEFECTS
 * constraints, BOUNDED relations of time alone and ENCLOSED other ones that have bounds.
 */
#ifndef HYBRID_LAWS_H
#define HYBRID_LAWS_H

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>

#if !defined NX || !defined NZ || !defined NU
#error "define NX, NZ and NU: how many states, algebraic unknowns and inputs with modes there are"
#endif
#if !defined MODES || !defined EVENTS || !defined ASSIGNED || !defined DEFECTS ||                  \
    !defined BOUNDED || !defined ENCLOSED
#error "define MODES, EVENTS, ASSIGNED, DEFECTS, BOUNDED and ENCLOSED, the sizes of the laws"
#endif

enum { KEEPS = 2 }; /* `at_zero` of a relation that has the mode of either side there */

/* How inputs, whose rates may be unknown, move an argument. */
enum {
    BY_NONE,
    BY_SOME,  /* among others, or through unknowns that may depend on inputs */
    BY_INPUTS /* by nothing else */
};

typedef struct {
    bool floor;   /* its mode is the floor of its argument, not the sign */
    bool of_time; /* the argument depends on time and parameters alone ... */
    bool linear;  /* ... and is linear in time */
    int moved;    /* how inputs move the argument */
    bool in_laws; /* dx/dt, an unknown or another model depends on its mode */
    int at_zero;  /* mode of a sign while its argument rests at 0: -1, 0, 1, or KEEPS */
} Relation;

typedef struct {
    int first, count;      /* of `assigned` */
    int barrier, barriers; /* of `barriers`: relations of the condition whose rates it changes */
    bool sampled;          /* the condition counts samples: from 0 on */
    bool ends;             /* it ends the run */
} Rule;

/* A place of a motion; z is a guess, and is solved for, as are the modes in u that slide. */
typedef struct {
    double t;
    const double *x;
    double *z, *u;
} Point;

/* Relations at a point: arguments with their first and second time derivatives along a solution,
 * and sizes beside which a first derivative is rounding; and dx/dt and du/dt. */
typedef struct {
    double arguments[MODES + 1], rates[MODES + 1], seconds[MODES + 1], sizes[MODES + 1];
    double slopes[NX + 1], moves[NU + 1];
    double departs[MODES + 1]; /* the kernel's: infinite, the side to which one slowly leaves 0 */
} Seen;

/* What rounding makes of relations, relative to 1: of an argument, with states of their sizes or as
 * small as they are, and of its first time derivative, by the terms that it is the sum of. */
typedef struct {
    double sized[MODES + 1], least[MODES + 1], rates[MODES + 1];
} Spread;

/* Rules at a point: conditions, what they assign, and how far each constraint is violated. */
typedef struct {
    double conditions[EVENTS + 1], values[ASSIGNED + 1], defects[DEFECTS + 1];
} Decision;

/* Least and greatest values of states and inputs, and of their rates, over a part of a step. */
typedef struct {
    double low[NX + NU + 1], high[NX + NU + 1], slowest[NX + NU + 1], fastest[NX + NU + 1];
} Spans;

/* The laws of a model, called with their owner. Functions return whether there is a value. */
typedef struct {
    void *owner;
    const Relation *relations;
    const Rule *rules;
    const int *assigned; /* states */
    const bool *adds;    /* whether an assignment adds to its state what does not depend on it */
    const int *barriers; /* relations */
    const int *bounded;  /* relations of time whose arguments have bounds, BOUNDED of them */
    const int *enclosed; /* other relations whose arguments have bounds, ENCLOSED of them */
    double *room;        /* MODES * MODES numbers for what slides: more than a stack may hold */
    bool blind;          /* rates of inputs are unknown, and a step ends a little beyond an event */
    bool set;            /* values have been set since one that is blind has looked */
    bool (*see)(void *owner, const Point *at, Seen *found);
    bool (*decide)(void *owner, const Point *at, Decision *found);
    bool (*spread)(void *owner, const Point *at, Spread *found);
    /* arguments of time alone at a time, and their rates; the others are not set */
    bool (*timed)(void *owner, const Point *at, double t, double arguments[], double rates[]);
    /* bounds of such arguments and of two time derivatives, from a time over a length */
    bool (*bounds)(void *owner, const Point *at, double t, double length, double low[],
                   double high[]);
    /* bounds of an argument and of its rate, in turns, over a length from the time of a point on */
    bool (*enclose)(void *owner, const Point *at, double length, const Spans *spans, double low[],
                    double high[]);
} Laws;

static inline double *modes_of(const Point *at) {
    return at->u + NU - MODES;
}

#endif
