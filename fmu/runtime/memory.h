/* Memory of instances and of saved states: from the heap, or with FMU_STATIC, a number of bytes,
   from a static block that is enough for one instance, without saved states. */
#ifndef MEMORY_H
#define MEMORY_H

#include <stddef.h>

/* Zeroed memory, or NULL. */
static void *take_memory(size_t size);
static void give_memory(void *memory);

#endif
