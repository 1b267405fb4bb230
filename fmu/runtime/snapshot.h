/* Copies of the FMU state; the copy in memory and the serialized one are the same bytes. */
#ifndef SNAPSHOT_H
#define SNAPSHOT_H

#include "instance.h"

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility push(hidden)
#endif

Status take_snapshot(Instance *self, void **snapshot);
Status restore_snapshot(Instance *self, const void *snapshot);
Status release_snapshot(Instance *self, void **snapshot);
Status snapshot_size(Instance *self, const void *snapshot, size_t *size);
Status serialize(Instance *self, const void *snapshot, void *bytes, size_t size);
Status deserialize(Instance *self, const void *bytes, size_t size, void **snapshot);

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility pop
#endif

#endif
