/* Texts as numbers: those of the parts of a system, where equal texts have one number. So they are
 * exchanged as other values are. */
#ifndef TEXTS_H
#define TEXTS_H

#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
typedef int Lock; /* of nothing, as there parts step one after the other */
static inline void lock(Lock *self) {
    (void)self;
}
static inline void unlock(Lock *self) {
    (void)self;
}
#else
#include <pthread.h>
typedef pthread_mutex_t Lock;
static inline void lock(Lock *self) {
    pthread_mutex_lock(self);
}
static inline void unlock(Lock *self) {
    pthread_mutex_unlock(self);
}
#endif

typedef struct {
    Lock lock;
    char **text;
    long long count, room;
} Texts;

/* Returns NULL if there is no memory. */
static inline Texts *new_texts(void) {
    Texts *self = calloc(1, sizeof *self);
#ifndef _WIN32
    if (self) pthread_mutex_init(&self->lock, NULL);
#endif
    return self;
}

static inline void free_texts(Texts *self) {
    if (!self) return;
    for (long long i = 0; i < self->count; ++i) free(self->text[i]);
    free(self->text);
#ifndef _WIN32
    pthread_mutex_destroy(&self->lock);
#endif
    free(self);
}

static inline double add_text(Texts *self, const char *text) {
    const size_t size = strlen(text) + 1;
    if (self->count == self->room) {
        const long long room = 2 * self->room + 8;
        char **more = realloc(self->text, (size_t)room * sizeof *more);
        if (!more) return -1;
        self->text = more;
        self->room = room;
    }
    char *own = malloc(size);
    if (!own) return -1;
    memcpy(own, text, size);
    self->text[self->count++] = own;
    return (double)self->count;
}

/* The number of a text: 0 if it is empty, below 0 if there is no memory. */
static inline double number_of_text(Texts *self, const char *text) {
    if (!text || !*text) return 0;
    lock(&self->lock);
    long long i = self->count; /* the last ones are the likely ones */
    while (i > 0 && strcmp(self->text[i - 1], text) != 0) --i;
    const double found = i > 0 ? (double)i : add_text(self, text);
    unlock(&self->lock);
    return found;
}

static inline const char *text_of_number(Texts *self, double number) {
    if (!(number >= 1)) return "";
    lock(&self->lock);
    const char *text = self->text[(long long)number - 1];
    unlock(&self->lock);
    return text;
}

#endif
