/* Steps the kernel of events without an integrator: a body between a wall, dry friction and a
 * clock.
 *
 *     x' = v, v' = load - friction sign(v); when x < 0: v = -v/2, hits = hits + 1
 *     a second wall at the same place adds a hit, too; floor(t) is a clock
 */
#include <assert.h>
#include <stdio.h>

#define NX 3
#define NZ 0
#define NU 4
#define MODES 4
#define EVENTS 2
#define ASSIGNED 3
#define DEFECTS 0
#define BOUNDED 0
#define ENCLOSED 0
#include "happen.h"
#include "plan.h"
#include "search.h"

enum { SIGN, WALL, SECOND, CLOCK };

typedef struct {
    double load, friction;
} Body;

static const Relation relations[] = {
    {false, false, false, false, true, 0},   /* sign(v) */
    {false, false, false, false, false, -1}, /* x < 0 */
    {false, false, false, false, false, -1}, /* 2 x < 0 */
    {true, true, true, false, false, KEEPS}, /* floor(t) */
};
static const Rule rules[] = {{0, 2, 0, 1, false, false}, {2, 1, 1, 0, false, false}};
static const int assigned[] = {1, 2, 2}, barriers[] = {WALL}, bounded[] = {0}, enclosed[] = {0};
static const bool adds[] = {false, true, true};

static bool see(void *owner, const Point *at, Seen *found) {
    const Body *body = owner;
    const double v = at->x[1], a = body->load - body->friction * at->u[SIGN];
    const double arguments[] = {v, -at->x[0], -2 * at->x[0], at->t};
    const double rates[] = {a, -v, -2 * v, 1}, seconds[] = {0, -a, -2 * a, 0};
    const double sizes[] = {fabs(a) + 1, fabs(v) + 1, 2 * fabs(v) + 2, 0};
    memcpy(found->arguments, arguments, sizeof arguments);
    memcpy(found->rates, rates, sizeof rates);
    memcpy(found->seconds, seconds, sizeof seconds);
    memcpy(found->sizes, sizes, sizeof sizes);
    found->slopes[0] = v;
    found->slopes[1] = a;
    found->slopes[2] = found->moves[SIGN] = found->moves[WALL] = found->moves[SECOND] = 0;
    found->moves[CLOCK] = 0;
    return isfinite(v);
}

static bool decide_rules(void *owner, const Point *at, Decision *found) {
    (void)owner;
    found->conditions[0] = at->u[WALL] > 0;
    found->conditions[1] = at->u[SECOND] > 0;
    found->values[0] = -at->x[1] / 2;
    found->values[1] = found->values[2] = at->x[2] + 1;
    return true;
}

static bool spread(void *owner, const Point *at, Spread *found) {
    const Body *body = owner;
    const double v = fabs(at->x[1]), a = fabs(body->load) + fabs(body->friction);
    const double rates[] = {a + 1, v + 1, 2 * v + 2, 0};
    memcpy(found->rates, rates, sizeof rates);
    for (int i = 0; i < MODES; i++) found->sized[i] = found->least[i] = 1;
    return true;
}

static bool timed(void *owner, const Point *at, double t, double arguments[], double rates[]) {
    (void)owner, (void)at;
    for (int i = 0; i < MODES; i++) arguments[i] = rates[i] = 0;
    arguments[CLOCK] = t;
    rates[CLOCK] = 1;
    return true;
}

static Laws laws_of(Body *body) {
    static double room[MODES * MODES];
    return (Laws){body,  relations, rules, assigned,     adds,   barriers, bounded, enclosed, room,
                  false, false,     see,   decide_rules, spread, timed,    NULL,    NULL};
}

static const bool nothing[MODES + 1];

static Happening happened(const Laws *laws, Switching *s, Point *at, double x[], int crossing) {
    Happening found;
    bool replan;
    happen(laws, s, at, x, crossing, nothing, NULL, &found, &replan);
    return found;
}

static void walls_hit_together_count_both_and_once(void) {
    Body body = {-9.81, 0};
    const Laws laws = laws_of(&body);
    double x[NX + 1] = {0, -2, 0}, u[NU + 1] = {0};
    Point at = {0.25, x, NULL, u};
    Switching s;
    x[0] = 1;
    assert(begin_modes(&laws, &s, &at, 10).reason == GOES_ON);
    assert(begin_events(&laws, &s, &at).reason == GOES_ON);
    assert(u[SIGN] == -1 && u[WALL] == -1 && u[CLOCK] == 0);
    x[0] = -1e-17;
    const Happening found = happened(&laws, &s, &at, x, WALL);
    assert(found.ending.reason == GOES_ON && found.count == 2 && found.rounds == 1);
    assert(x[1] == 1 && x[2] == 2 && u[SIGN] == 1 && u[WALL] == -1);
    const Happening again = happened(&laws, &s, &at, x, -1); /* nothing is due any more */
    assert(again.count == 0 && !again.states_changed && !again.modes_changed && x[2] == 2);
}

static void friction_sticks_and_releases_on_the_side_of_the_load(void) {
    Body body = {0.5, 1};
    const Laws laws = laws_of(&body);
    double x[NX + 1] = {5, 0, 0}, u[NU + 1] = {0};
    Point at = {0.25, x, NULL, u};
    Switching s;
    assert(begin_modes(&laws, &s, &at, 10).reason == GOES_ON);
    assert(s.state[SIGN] == SLIDES && fabs(u[SIGN] - 0.5) < 1e-15);
    body.load = -1.5;
    assert(happened(&laws, &s, &at, x, SIGN).ending.reason == GOES_ON);
    assert(s.state[SIGN] != SLIDES && u[SIGN] == -1);
    body.load = body.friction = 0; /* nothing moves it: the sign of what rests is 0 */
    assert(begin_modes(&laws, &s, &at, 10).reason == GOES_ON);
    assert(s.state[SIGN] != SLIDES && u[SIGN] == 0);
}

static void a_condition_that_stays_true_ends_the_run(void) {
    Body body = {-9.81, 0};
    const Laws laws = laws_of(&body);
    double x[NX + 1] = {0, 0, 0}, u[NU + 1] = {0};
    Point at = {0, x, NULL, u};
    Switching s;
    assert(begin_modes(&laws, &s, &at, 10).reason == GOES_ON);
    assert(begin_events(&laws, &s, &at).reason == GOES_ON);
    const Happening found = happened(&laws, &s, &at, x, -1);
    assert(found.ending.reason == STAYS_TRUE && found.ending.part == 0);
}

static void events_that_are_ever_closer_are_rejected(void) {
    Body body = {-9.81, 0};
    const Laws laws = laws_of(&body);
    double x[NX + 1] = {1, -2, 0}, u[NU + 1] = {0};
    Point at = {0.25, x, NULL, u};
    Switching s;
    Reason reason = GOES_ON;
    assert(begin_modes(&laws, &s, &at, 10).reason == GOES_ON);
    int n = 0;
    for (; n < 30 && reason == GOES_ON; n++) {
        at.t += 1e-13;
        x[0] = 0;
        x[1] = -2;
        reason = happened(&laws, &s, &at, x, WALL).ending.reason;
    }
    assert(reason == TOO_CLOSE && n > MOST_CLOSE);
}

static void the_clock_is_planned_and_due(void) {
    Body body = {0, 0};
    const Laws laws = laws_of(&body);
    double x[NX + 1] = {1, 1, 0}, u[NU + 1] = {0};
    Point at = {0.25, x, NULL, u};
    Switching s;
    assert(begin_modes(&laws, &s, &at, 10).reason == GOES_ON);
    plan(&laws, &s, &at, at.t, 10, true, NEVER_AGAIN);
    assert(s.next == 1);
    at.t = 1;
    assert(happened(&laws, &s, &at, x, -1).modes_changed && u[CLOCK] == 1);
    plan(&laws, &s, &at, at.t, 10, true, NEVER_AGAIN);
    assert(s.next == 2);
}

typedef struct {
    double depth, fresh; /* of a parabola 4 (t - 1/2)^2 - depth, on the interpolant and afresh */
} Parabola;

static void parabola_at(double depth, double t, Place *found) {
    for (int i = 0; i < MODES; i++) found->inside[i] = 1, found->rates[i] = 0;
    found->t = t;
    found->inside[WALL] = 4 * (t - 0.5) * (t - 0.5) - depth;
    found->rates[WALL] = 8 * (t - 0.5);
}

static void look(void *motion, double t, Place *found) {
    parabola_at(((Parabola *)motion)->depth, t, found);
}

static bool proven(void *motion, const Place *a, const Place *b) {
    (void)motion, (void)a, (void)b;
    return true;
}

static bool step(void *motion, double t, Place *found) {
    parabola_at(((Parabola *)motion)->fresh, t, found);
    return true;
}

static void a_crossing_is_located_and_a_touch_is_none(void) {
    const Laws laws = {.relations = relations};
    const Switching fresh = {.span = 1};
    Place before;
    Crossing found;
    Parabola crosses = {0.01, 0.01}, touches = {1e-9, -1e-9};
    look(&crosses, 0, &before);
    assert(find_crossing(look, proven, step, &crosses, &laws, &fresh, 0, before, 1, AS_IS,
                         &found) == CROSSES);
    assert(found.relation == WALL && fabs(found.time - 0.45) < 1e-15);
    look(&touches, 0, &before);
    assert(find_crossing(look, proven, step, &touches, &laws, &fresh, 0, before, 1, AS_IS,
                         &found) == CROSSES);
    assert(found.relation < 0);
}

/* A dip between two looks, which bounds do not exclude, after a touch, which they never do. */
static const double TOUCHED = 0.35, AT = 0.3717, WIDTH = 1e-7;

static void look_at_dip(void *motion, double t, Place *found) {
    parabola_at(-1, t, found);
    found->inside[WALL] = fabs(t - AT) < WIDTH ? -1 : 1;
    found->rates[WALL] = 0;
    (void)motion;
}

static bool step_into_dip(void *motion, double t, Place *found) {
    look_at_dip(motion, t, found);
    found->inside[WALL] = AT - WIDTH - t; /* as of a slope */
    found->rates[WALL] = -1;
    return true;
}

static bool has_no_dip(void *motion, const Place *a, const Place *b) {
    (void)motion;
    const bool touches = a->t <= TOUCHED && TOUCHED <= b->t;
    return !touches && (b->t < AT - WIDTH || a->t > AT + WIDTH);
}

static void what_bounds_do_not_exclude_is_looked_at_closely(void) {
    const Laws laws = {.relations = relations};
    const Switching fresh = {.span = 1};
    Place before;
    Crossing found;
    look_at_dip(NULL, 0, &before);
    assert(find_crossing(look_at_dip, proven, step_into_dip, NULL, &laws, &fresh, 0, before, 1,
                         AS_IS, &found) == CROSSES);
    assert(found.relation < 0);
    assert(find_crossing(look_at_dip, has_no_dip, step_into_dip, NULL, &laws, &fresh, 0, before, 1,
                         AS_IS, &found) == CROSSES);
    assert(found.relation == WALL && fabs(found.time - (AT - WIDTH)) < 1e-15);
}

/* Where the interpolant sees only SECOND leave, fresh steps also go through WALL and back. */
static void look_late(void *motion, double t, Place *found) {
    parabola_at(-1, t, found);
    found->inside[SECOND] = 0.6 - t;
    found->rates[SECOND] = -1;
    (void)motion;
}

static bool step_both(void *motion, double t, Place *found) {
    parabola_at(((Parabola *)motion)->fresh, t, found);
    found->inside[SECOND] = 0.52 - t;
    found->rates[SECOND] = -1;
    return true;
}

static void what_has_left_and_comes_back_was_first(void) {
    const Laws laws = {.relations = relations};
    const Switching fresh = {.span = 1};
    Place before;
    Crossing found;
    Parabola motion = {0, 0.01};
    look_late(&motion, 0, &before);
    assert(find_crossing(look_late, proven, step_both, &motion, &laws, &fresh, 0, before, 1, AS_IS,
                         &found) == CROSSES);
    assert(found.relation == WALL && fabs(found.time - 0.45) < 1e-15);
}

/* What only rounding is between it and its end crosses there, unless inputs may turn it. */
static void only_what_inputs_move_waits_where_they_may_turn(void) {
    Relation driven[MODES];
    memcpy(driven, relations, sizeof relations);
    driven[WALL].moved = BY_SOME;
    const Laws laws = {.relations = relations}, with_input = {.relations = driven};
    const Switching fresh = {.span = 1};
    Place end;
    note_no_event(1, &end);
    end.inside[WALL] = 4 * DBL_EPSILON;
    end.rates[WALL] = -1;
    assert(leaving_at(&laws, &fresh, &end, AS_IS) == WALL);
    assert(leaving_at(&laws, &fresh, &end, BUT_INPUTS) == WALL);
    assert(leaving_at(&laws, &fresh, &end, BY_EVENTS) < 0);
    assert(leaving_at(&with_input, &fresh, &end, AS_IS) == WALL);
    assert(leaving_at(&with_input, &fresh, &end, BUT_INPUTS) < 0);
}

int main(void) {
    only_what_inputs_move_waits_where_they_may_turn();
    walls_hit_together_count_both_and_once();
    friction_sticks_and_releases_on_the_side_of_the_load();
    a_condition_that_stays_true_ends_the_run();
    events_that_are_ever_closer_are_rejected();
    the_clock_is_planned_and_due();
    a_crossing_is_located_and_a_touch_is_none();
    what_bounds_do_not_exclude_is_looked_at_closely();
    what_has_left_and_comes_back_was_first();
    puts("all right");
    return 0;
}
