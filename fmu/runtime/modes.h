/* The laws of a model for the kernel of events, and the relations of an instance: solvers/hybrid
   says how these switch. Without HAS_EVENTS there are none. */
#ifndef MODES_H
#define MODES_H

#include "integration.h"
#include "state.h"

#if HAS_EVENTS
#include "search.h"

enum { SPAN = 50 }; /* of a run without an end, in largest steps */

static Laws laws_of(Instance *self);
static Point present(Instance *self);

/* Refuse what the kernel cannot go on from; `switched` names what did so if no rule has. */
static Status refuse_ending(Instance *self, Status severity, const Ending *why,
                            const char *switched);

/* The modes of the start values. */
static Status start_modes(Instance *self);

/* In step mode, put relations on the sides that inputs and parameters require which were set since
   the last step, as an event at the start of the next one will; and put them back, which a step and
   a setter do before anything else. An importer that handles events does so in event mode. */
static void take_sides(Instance *self);
static void leave_sides(Instance *self);

/* Set the modes of relations that slide, at the present values or at a point; false where there are
   none that keep their arguments. */
static Status follow_present(Instance *self);
static bool follow_at(Instance *self, const Point *at);
#define is_sliding_now(self) any_is(&(self)->state.switching, SLIDES)

/* The relations at the present values; how far those not of time alone are within their modes. */
static Status look_now(Instance *self, Seen *seen);
static Status get_insides(Instance *self, double inside[]);

/* Refuse, where a relation slides, inputs that move its argument, and let go of boundaries that an
   event has displaced. */
static Status complete_step(Instance *self, Status severity);

/* The first crossing of a relation within a step, where fresh steps cross; relation -1: none. False
   where the last fresh step failed. */
static bool find_event(Instance *self, const Motion *motion, double begin, double end,
                       Crossing *crossing);

/* The relation that leaves its mode first on a motion of which no step can be made afresh, or -1;
   `found`: the margins there. */
static int left_between(Instance *self, const Motion *motion, double begin, double end,
                        Place *found);
#else
#define start_modes(self) ((void)(self), OK)
#define take_sides(self) ((void)(self))
#define leave_sides(self) ((void)(self))
#define follow_present(self) ((void)(self), OK)
#define complete_step(self, severity) ((void)(self), (void)(severity), OK)
#define get_insides(self, inside) ((void)(self), (void)(inside), OK)
#define is_sliding_now(self) ((void)(self), false)
#endif

#endif
