/* Memory of instances and of saved states. */
#include "memory.h"

#ifdef FMU_STATIC
#include <stdbool.h>
#include <string.h>

_Static_assert(FMU_STATIC >= 1024, "give the bytes of an instance, as -DFMU_STATIC=65536");
static double block[FMU_STATIC / sizeof(double)];
static bool taken;

void *take_memory(size_t size) {
    if (taken || size > sizeof block) return NULL;
    taken = true;
    return memset(block, 0, size);
}

void give_memory(void *memory) {
    if (memory == block) taken = false;
}
#else
#include <stdlib.h>

void *take_memory(size_t size) {
    return calloc(1, size);
}

void give_memory(void *memory) {
    free(memory);
}
#endif
