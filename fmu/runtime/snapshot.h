/* Copies of the FMU state; the copy in memory and the serialized one are the same bytes. */
#ifndef SNAPSHOT_H
#define SNAPSHOT_H

#include "state.h"

static Status take_snapshot(Instance *self, void **snapshot);
static Status restore_snapshot(Instance *self, const void *snapshot);
static Status release_snapshot(Instance *self, void **snapshot);
static Status snapshot_size(Instance *self, const void *snapshot, size_t *size);
static Status serialize(Instance *self, const void *snapshot, void *bytes, size_t size);
static Status deserialize(Instance *self, const void *bytes, size_t size, void **snapshot);

#endif
