/* Memory of instances and of saved states: from the heap, or with FMU_STATIC, a number of bytes,
   from a static block that is enough for one instance, without saved states. */
#ifndef MEMORY_H
#define MEMORY_H

#include <stddef.h>

#ifdef FMU_STATIC
#include <stdbool.h>
#include <string.h>

_Static_assert(FMU_STATIC >= 1024, "give the bytes of an instance, as -DFMU_STATIC=65536");
static double block[FMU_STATIC / sizeof(double)];
static bool taken;

/* Zeroed memory, or NULL. */
static void *take_memory(size_t size) {
    if (taken || size > sizeof block) return NULL;
    taken = true;
    return memset(block, 0, size);
}

static void give_memory(void *memory) {
    if (memory == block) taken = false;
}
#else
#include <stdlib.h>

/* Zeroed memory, or NULL. */
static void *take_memory(size_t size) {
    return calloc(1, size);
}

static void give_memory(void *memory) {
    free(memory);
}
#endif

#endif
