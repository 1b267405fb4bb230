/* Copies of the FMU state; the copy in memory and the serialized one are the same bytes. */
#ifndef SNAPSHOT_H
#define SNAPSHOT_H

#include "state.h"
#include "visibility.h"

INSIDE_BEGIN

Status take_snapshot(Instance *self, void **snapshot);
Status restore_snapshot(Instance *self, const void *snapshot);
Status release_snapshot(Instance *self, void **snapshot);
Status snapshot_size(Instance *self, const void *snapshot, size_t *size);
Status serialize(Instance *self, const void *snapshot, void *bytes, size_t size);
Status deserialize(Instance *self, const void *bytes, size_t size, void **snapshot);

INSIDE_END

#endif
