/* An FMU of version 2 or 3 behind one set of functions; its last status. */
#ifndef FMU_H
#define FMU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "texts.h"

enum { TOGETHER = 32 };                       /* variables of a call that wants an order for each */
enum { OK, WARNING, DISCARD, FAILED, FATAL }; /* status; FMI 2 and 3 agree */
enum { LAST_SUCCESSFUL_TIME = 2, TERMINATED = 3 }; /* kinds of FMI 2's status */
enum { MOST_UPDATES = 1000 };                      /* of discrete states at one time */

/* FMI 2's fmi2EventInfo. */
typedef struct {
    int needed, terminate, nominals, values, next_defined;
    double next;
} EventInfo;

/* Functions by their name in the FMI, without prefix; a field is NULL where nothing calls it. Names
 * of FMI 3 stand for both versions; what differs in its arguments is there for each. */
typedef struct {
    long long version;
    void *instance;
    void *stepper; /* what steps, events and states belong to: the instance, or its own solver */
    long long *is_fatal; /* set once nothing of the instance may be called any more */
    int (*set_time)(void *, double);
    int (*get_states)(void *, double *, size_t);
    int (*set_states)(void *, const double *, size_t);
    int (*get_derivatives)(void *, double *, size_t);
    int (*get_indicators)(void *, double *, size_t);
    int (*enter_event_mode)(void *);
    int (*enter_continuous_time_mode)(void *);
    int (*enter_step_mode)(void *);
    int (*new_discrete_states)(void *, EventInfo *);
    int (*update_discrete_states)(void *, bool *, bool *, bool *, bool *, bool *, double *);
    int (*completed_step_2)(void *, int, int *, int *);
    int (*completed_step_3)(void *, bool, bool *, bool *);
    int (*do_step_2)(void *, double, double, int);
    int (*do_step_3)(void *, double, double, bool, bool *, bool *, bool *, double *);
    int (*get_boolean_status)(void *, int, int *);
    int (*get_real_status)(void *, int, double *);
    int (*set_input_derivatives)(void *, const uint32_t *, size_t, const int32_t *, const double *);
    int (*output_derivatives_2)(void *, const uint32_t *, size_t, const int32_t *, double *);
    int (*output_derivatives_3)(void *, const uint32_t *, size_t, const int32_t *, double *,
                                size_t);
    int (*directional_2)(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *,
                         double *);
    int (*directional_3)(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *,
                         size_t, double *, size_t);
    int (*get_fmu_state)(void *, void **);
    int (*set_fmu_state)(void *, void *);
    int (*free_fmu_state)(void *, void **);
} Functions;

typedef struct {
    const Functions *call;
    const char *function;       /* field of what failed; NULL where nothing did */
    int status;                 /* and how */
    volatile long long *called; /* where a coupled system notes the part that it calls, or NULL */
    Texts *texts;               /* of a coupled system, or NULL */
} Fmu;

/* Notes a failure; tells whether there is one. */
static inline int failed(Fmu *self, const char *function, int status) {
    if (status == OK || status == WARNING) return 0;
    self->function = function;
    self->status = status;
    if (status == FATAL) *self->call->is_fatal = 1;
    return 1;
}

/* When an FMU wants to be in event mode next, and whether it wants to end. */
typedef struct {
    bool terminate, next_defined;
    double next;
} Events;

/* Discrete states once; `needed` tells whether to ask again. Returns 0 unless the call fails. */
static inline int update_once(Fmu *self, bool *needed, Events *events) {
    const Functions *call = self->call;
    bool nominals, values;
    if (!call->new_discrete_states)
        return failed(self, "update_discrete_states",
                      call->update_discrete_states(call->stepper, needed, &events->terminate,
                                                   &nominals, &values, &events->next_defined,
                                                   &events->next));
    EventInfo info = {0};
    if (failed(self, "new_discrete_states", call->new_discrete_states(call->stepper, &info)))
        return 1;
    *needed = info.needed;
    *events = (Events){info.terminate, info.next_defined, info.next};
    return 0;
}

/* Discrete states of one time until they stay. Returns 0 unless a call fails. */
static inline int update(Fmu *self, Events *events) {
    bool needed = true;
    for (int i = 0; needed && !events->terminate; ++i) {
        if (i == MOST_UPDATES) return failed(self, "the iteration of discrete states", FAILED);
        if (update_once(self, &needed, events)) return 1;
    }
    return 0;
}

/* Whether a step that is complete is followed by an event. Returns 0 unless the call fails. */
static inline int completed_step(Fmu *self, bool *event, bool *terminate) {
    const Functions *call = self->call;
    if (call->version == 2) {
        int enter = 0, end = 0;
        const int status = call->completed_step_2(call->instance, 1, &enter, &end);
        *event = enter;
        *terminate = end;
        return failed(self, "completed_step_2", status);
    }
    return failed(self, "completed_step_3",
                  call->completed_step_3(call->instance, true, event, terminate));
}

#endif
