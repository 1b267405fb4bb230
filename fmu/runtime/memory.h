/* Memory of instances and of saved states: from the heap, or with FMU_STATIC, a number of bytes,
   from a static block that is enough for one instance, without saved states. */
#ifndef MEMORY_H
#define MEMORY_H

#include <stddef.h>

#include "visibility.h"

INSIDE_BEGIN

/* Zeroed memory, or NULL. */
void *take_memory(size_t size);
void give_memory(void *memory);

INSIDE_END

#endif
