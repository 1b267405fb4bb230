/* Life of an instance: creation, reset, what is allowed when. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <ctype.h>
#include <math.h>
#include <string.h>

#include "constants.h"
#include "equations.h"
#include "input_motion.h"
#include "logging.h"
#include "memory.h"

#define INSTANCE_MAGIC UINT64_C(0x636f73696d464d55)

/* Put everything but logging back to where a new instance has it. */
static void reset(Instance *self) {
    const uint32_t interface = self->state.interface;
    memset(&self->state, 0, sizeof self->state);
    for (size_t i = 0; i < N_VARIABLES; i++) self->state.values[i] = variables[i].start;
    for (int i = 0; i < NX; i++) self->state.guesses[i] = variables[FIRST_STATE + i].guess;
    self->state.stop_time = INFINITY;
    self->state.tolerance = DEFAULT_TOLERANCE;
    self->state.interface = interface;
    self->state.mode = INSTANTIATED;
    self->state.stale = EVERYTHING;
#if HAS_EVENTS
    memset(self->leapt, 0, sizeof self->leapt);
#endif
    renew_constants(self);
}

static bool is_blank(const char *text) {
    while (*text && isspace((unsigned char)*text)) text++;
    return *text == '\0';
}

/* Return a new instance, or NULL after a log message. All memory is one block. */
static Instance *create(const Host *host, const char *function, const char *name, const char *token,
                        unsigned interface, bool logging) {
    Instance draft = {.host = *host, .name = name ? name : "", .categories = UINT32_MAX};
    draft.function = function;
    if (interface != INTERFACE_ME && interface != INTERFACE_CS) {
        log_text(&draft, ERROR, "the model offers model exchange and co-simulation only");
        return NULL;
    }
    if (!name || is_blank(name)) {
        log_text(&draft, ERROR, "an instance needs a name");
        return NULL;
    }
    if (!token || strcmp(token, MODEL_GUID) != 0) {
        log_text(
            &draft, ERROR,
            "the model description is not this binary's: its GUID is %.80s, the binary's is %s",
            token ? token : "missing", MODEL_GUID);
        return NULL;
    }

    const size_t name_size = strlen(name) + 1;
    const size_t jacobian = (NX + NZ) * (NX + NU), doubles = ROOM_OF_W + MODES * MODES;
    const size_t size = sizeof(Instance) + jacobian * sizeof(double) +
                        ROOM_OF_ARG * sizeof *draft.arg + ROOM_OF_RES * sizeof *draft.res +
                        ROOM_OF_IW * sizeof *draft.iw + doubles * sizeof *draft.w + name_size;
    Instance *self = take_memory(size);
    if (!self) {
        log_text(&draft, ERROR, "no memory for an instance of %zu bytes", size);
        return NULL;
    }
    *self = draft;
    self->magic = INSTANCE_MAGIC;
    self->categories = logging ? UINT32_MAX : 0;
    self->jacobian = (double *)(self + 1);
    self->w = self->jacobian + jacobian;
    void *behind = self->w + doubles;
    self->iw = behind;
    self->arg = (const double **)(self->iw + ROOM_OF_IW);
    self->res = (double **)(self->arg + ROOM_OF_ARG);
    self->name = memcpy(self->res + ROOM_OF_RES, name, name_size);
    self->state.interface = interface;
#if HAS_EVENTS
    for (int i = 0; i < NX; i++) self->sizes[i] = variables[FIRST_STATE + i].nominal;
    self->laws = (LawOwner){.c = self->constants,
                            .sizes = self->sizes,
                            .arg = self->arg,
                            .res = self->res,
                            .iw = self->iw,
                            .w = self->w,
                            .move = input_slopes_at,
                            .owner = self,
                            .departure = self->state.departure};
#endif
    self->constants[0] = NAN; /* those of no parameters */
    reset(self);
    return self;
}

static void destroy(Instance *self) {
    if (!self || self->magic != INSTANCE_MAGIC) return;
    *(volatile uint64_t *)&self->magic = 0; /* compilers drop a plain write that is never read */
    give_memory(self);
}

static const char *mode_name(uint32_t mode) {
    switch (mode) {
    case INSTANTIATED: return "after instantiation";
    case INITIALIZATION_MODE: return "in initialization mode";
    case EVENT_MODE: return "in event mode";
    case CONTINUOUS_TIME_MODE: return "in continuous-time mode";
    case STEP_MODE: return "between communication steps";
    case STEP_FAILED: return "after a failed communication step";
    case TERMINATED: return "after termination";
    case INTERMEDIATE_UPDATE: return "in an intermediate update";
    case INTERMEDIATE_INPUTS: return "in an intermediate update that asks for inputs";
    default: return "after an error";
    }
}

/* Guard of every FMI function: is it allowed in the present mode and for this interface? */
static bool allowed(Instance *self, unsigned modes, const char *function) {
    if (!self || self->magic != INSTANCE_MAGIC) return false;
    self->function = function;
    if (!(self->state.interface & modes)) {
        refuse(self, ERROR, "not a function of %s",
               self->state.interface == INTERFACE_ME ? "model exchange" : "co-simulation");
        return false;
    }
    if (!(self->state.mode & modes)) {
        refuse(self, ERROR, "not allowed %s", mode_name(self->state.mode));
        return false;
    }
    return true;
}

static Status enter(Instance *self, uint32_t mode) {
    self->state.mode = mode;
    return OK;
}

/* What functions for types that no variable has do. */
static Status no_variables(Instance *self, size_t asked) {
    return asked == 0 ? OK : refuse(self, ERROR, "the model has no variable of this type");
}

#endif
