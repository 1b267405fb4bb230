/* Copies of the FMU state: a header that names model, version, size and checksum, then the state.

   Nothing is restored that was not made by the same model and interface and is not whole. A
   refused snapshot is an error, but leaves the instance in the mode it was in. */
#ifndef SNAPSHOT_H
#define SNAPSHOT_H

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "constants.h"
#include "evaluation.h"
#include "logging.h"
#include "memory.h"

#define SNAPSHOT_MAGIC UINT64_C(0x554d466d69736f63) /* its bytes tell the byte order, too */

enum { LAYOUT_VERSION = 22 };

typedef struct {
    uint64_t magic;
    uint32_t layout;
    uint32_t fmi_version;
    uint64_t size; /* of the state */
    uint64_t model;
    uint64_t checksum; /* of the state */
} Header;

typedef struct {
    Header header;
    State state;
} Snapshot;

static inline uint64_t word_at(const unsigned char *bytes) {
    uint64_t word;
    memcpy(&word, bytes, sizeof word);
    return word;
}

/* FNV-1a (Fowler, Noll, Vo) of words of 64 bits. The shift lets the highest bits count, too, so
   that changes of two signs do not cancel. */
static inline uint64_t mixed(uint64_t sum, uint64_t word) {
    sum = (sum ^ word) * UINT64_C(1099511628211);
    return sum ^ sum >> 32;
}

/* Four sums, which do not wait for each other: every change of a single word changes the result. */
static uint64_t hash(const void *data, size_t size) {
    enum { WORD = sizeof(uint64_t) };
    const unsigned char *bytes = data;
    unsigned char rest[4 * WORD] = {0};
    uint64_t a = UINT64_C(14695981039346656037), b = a, c = a, d = a;
    const size_t whole = size - size % sizeof rest;
    for (size_t i = 0; i <= whole; i += sizeof rest) {
        const unsigned char *next = i < whole ? bytes + i : rest;
        if (i == whole) memcpy(rest, bytes + whole, size - whole);
        a = mixed(a, word_at(next));
        b = mixed(b, word_at(next + WORD));
        c = mixed(c, word_at(next + 2 * WORD));
        d = mixed(d, word_at(next + 3 * WORD));
    }
    return mixed(mixed(mixed(a, b), c), d);
}

static Header header_of(const Instance *self, const State *state) {
    return (Header){
        .magic = SNAPSHOT_MAGIC,
        .layout = LAYOUT_VERSION,
        .fmi_version = self->host.fmi_version,
        .size = sizeof(State),
        .model = hash(MODEL_GUID, strlen(MODEL_GUID)),
        .checksum = hash(state, sizeof *state),
    };
}

static Status reject(Instance *self, const char *reason) {
    log_text(self, ERROR, "%s", reason);
    return ERROR;
}

/* Is the header that of a snapshot of this model? Read nothing behind it before that. */
static const char *foreign(const Instance *self, const Header *header) {
    if (header->magic != SNAPSHOT_MAGIC) return "this is not an FMU state";
    if (header->layout != LAYOUT_VERSION || header->fmi_version != self->host.fmi_version)
        return "the FMU state has another version";
    if (header->model != hash(MODEL_GUID, strlen(MODEL_GUID)) || header->size != sizeof(State))
        return "the FMU state belongs to another model";
    return NULL;
}

static bool is_mode(const Instance *self, uint32_t mode) {
    const bool exchange = self->state.interface == INTERFACE_ME;
    const uint32_t common = INSTANTIATED | INITIALIZATION_MODE | TERMINATED | FAULTY;
    const uint32_t events = exchange || self->host.event_mode ? EVENT_MODE : 0;
    const uint32_t own = exchange ? CONTINUOUS_TIME_MODE : STEP_MODE | STEP_FAILED;
    return mode & (common | events | own) && !(mode & (mode - 1));
}

/* Could this instance have come to hold such a state? */
static bool plausible(const Instance *self, const State *state) {
    if (state->interface != self->state.interface || !is_mode(self, state->mode)) return false;
    if (state->stale > (EVERYTHING | SIDES) || state->experiment_set > 1 ||
        state->motion_spent > 1 || state->retuned > 1 || state->violated > N_LIMITS ||
        state->step_status > ERROR)
        return false;
    if (!(state->tolerance > 0 && state->tolerance < 1) || isnan(state->stop_time)) return false;
    /* from the motion of inputs on, all is doubles, up to a stop time that may be infinite */
    const size_t first = offsetof(State, motion), end = offsetof(State, stop_time);
    const void *numbers = (const char *)state + first;
    if (!all_finite(numbers, (int)((end - first) / sizeof(double)))) return false;
#if HAS_EVENTS
    const double waits = state->switching.waits;
    if (!(waits >= 0 && waits <= MODES + 1 && waits == floor(waits))) return false;
#endif
#if HAS_LOOKS
    const double left = state->looks.relation;
    if (!(left >= 0 && left <= MODES && left == floor(left))) return false;
#endif
    for (int i = 0; i < N_VARIABLES; i++) {
        const bool result = variables[i].role == DERIVATIVE || variables[i].role == OUTPUT;
        if (!result && !isfinite(state->values[i])) return false;
    }
    return true;
}

/* Why a snapshot cannot be restored; NULL when it can. */
static const char *fault_of(const Instance *self, const void *memory) {
    const Snapshot *snapshot = memory;
    const char *reason = snapshot ? foreign(self, &snapshot->header) : "the FMU state is missing";
    if (reason) return reason;
    if (snapshot->header.checksum != hash(&snapshot->state, sizeof snapshot->state))
        return "the FMU state is damaged";
    if (!plausible(self, &snapshot->state)) return "the FMU state does not fit this instance";
    return NULL;
}

/* Copy the state to a new snapshot, or into the one given. */
static Status take_snapshot(Instance *self, void **snapshot) {
    if (!snapshot) return reject(self, "there is no room for the FMU state");
    Snapshot *copy = *snapshot;
    if (!copy) copy = take_memory(sizeof *copy);
    if (!copy) return reject(self, "no memory for the FMU state");
    const char *reason = *snapshot ? foreign(self, &copy->header) : NULL;
    if (reason) return reject(self, reason);
    copy->state = self->state;
    copy->state.stale |= JACOBIAN; /* it is not part of the state */
    copy->header = header_of(self, &copy->state);
    *snapshot = copy;
    return OK;
}

static Status restore_snapshot(Instance *self, const void *snapshot) {
    const char *reason = fault_of(self, snapshot);
    if (reason) return reject(self, reason);
    self->state = ((const Snapshot *)snapshot)->state;
    renew_constants(self);
    return OK;
}

static Status release_snapshot(Instance *self, void **snapshot) {
    if (!snapshot || !*snapshot) return OK;
    Snapshot *copy = *snapshot;
    const char *reason = foreign(self, &copy->header);
    if (reason) return reject(self, reason);
    copy->header.magic = 0;
    give_memory(copy);
    *snapshot = NULL;
    return OK;
}

/* All have the same size; whoever reads or writes one looks whether it is whole. */
static Status snapshot_size(Instance *self, const void *snapshot, size_t *size) {
    const char *reason = snapshot ? foreign(self, snapshot) : "the FMU state is missing";
    if (!reason && !size) reason = "there is no room for the size";
    if (reason) return reject(self, reason);
    *size = sizeof(Snapshot);
    return OK;
}

static Status serialize(Instance *self, const void *snapshot, void *bytes, size_t size) {
    const char *reason = fault_of(self, snapshot);
    if (!reason && !bytes) reason = "there is no room for the bytes";
    if (!reason && size < sizeof(Snapshot)) reason = "there is too little room for the bytes";
    if (reason) return reject(self, reason);
    memcpy(bytes, snapshot, sizeof(Snapshot));
    return OK;
}

/* Make a new snapshot of bytes, if they are whole and of this model. */
static Status deserialize(Instance *self, const void *bytes, size_t size, void **snapshot) {
    if (!snapshot) return reject(self, "there is no room for the FMU state");
    if (!bytes) return reject(self, "the bytes are missing");
    if (size != sizeof(Snapshot)) return reject(self, "the bytes have another length");
    Snapshot *copy = take_memory(sizeof *copy);
    if (!copy) return reject(self, "no memory for the FMU state");
    memcpy(copy, bytes, sizeof *copy);
    const char *reason = fault_of(self, copy);
    if (reason) {
        give_memory(copy);
        return reject(self, reason);
    }
    *snapshot = copy;
    return OK;
}

#endif
