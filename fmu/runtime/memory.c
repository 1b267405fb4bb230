/* Memory of instances and of saved states. */
#include "memory.h"

#ifdef FMU_STATIC
#include <stdbool.h>
#include <string.h>

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
