/* A crew of threads that do a task at the same time, each on a member of an array. Where there are
 * no POSIX threads, the caller does all of it. */
#ifndef CREW_H
#define CREW_H

#include <stdlib.h>

typedef struct {
    void (*task)(void *member);
    char *members;
    size_t size; /* of a member */
    long long count;
    long long started; /* threads; the caller takes the other members */
    struct Hand *hands;
} Crew;

#ifdef _WIN32

static inline void crew_start(Crew *self) {
    self->started = 0;
}

static inline void crew_work(Crew *self) {
    for (long long i = 0; i < self->count; ++i) self->task(self->members + (size_t)i * self->size);
}

static inline void crew_end(Crew *self) {
    (void)self;
}

#else

#include <pthread.h>

enum { STACK = 8 << 20 }; /* bytes: FMUs take as much as main threads have; macOS gives 512 kB */

/* What the threads of a crew share. */
typedef struct {
    pthread_mutex_t lock;
    pthread_cond_t begin, end;
    long long round, left; /* rounds begun; threads that still work */
    int over;
} Signals;

struct Hand {
    const Crew *crew;
    Signals *signals;
    char *member;
    pthread_t thread;
};

static inline void *work_by_hand(void *given) {
    const struct Hand *self = given;
    Signals *signals = self->signals;
    pthread_mutex_lock(&signals->lock);
    for (long long done = 0;;) {
        while (signals->round == done && !signals->over)
            pthread_cond_wait(&signals->begin, &signals->lock);
        if (signals->over) break;
        done = signals->round;
        pthread_mutex_unlock(&signals->lock);
        self->crew->task(self->member);
        pthread_mutex_lock(&signals->lock);
        if (--signals->left == 0) pthread_cond_signal(&signals->end);
    }
    pthread_mutex_unlock(&signals->lock);
    return NULL;
}

/* Starts a thread for each member but the first; none where memory or threads are short. */
static inline void crew_start(Crew *self) {
    const size_t hands = (size_t)self->count - 1;
    pthread_attr_t attributes;
    self->started = 0;
    self->hands = malloc(hands * sizeof *self->hands + sizeof(Signals));
    if (!self->hands) return;
    Signals *signals = (Signals *)(self->hands + hands);
    *signals = (Signals){.round = 0};
    pthread_mutex_init(&signals->lock, NULL);
    pthread_cond_init(&signals->begin, NULL);
    pthread_cond_init(&signals->end, NULL);
    pthread_attr_init(&attributes);
    pthread_attr_setstacksize(&attributes, STACK);
    for (size_t i = 0; i < hands; ++i) {
        struct Hand *hand = self->hands + i;
        *hand = (struct Hand){self, signals, self->members + (i + 1) * self->size, 0};
        if (pthread_create(&hand->thread, &attributes, work_by_hand, hand)) break;
        ++self->started;
    }
    pthread_attr_destroy(&attributes);
}

/* Does the task on all members, and returns when all is done. */
static inline void crew_work(Crew *self) {
    Signals *signals = (Signals *)(self->hands + self->count - 1);
    if (self->started) {
        pthread_mutex_lock(&signals->lock);
        signals->left = self->started;
        ++signals->round;
        pthread_cond_broadcast(&signals->begin);
        pthread_mutex_unlock(&signals->lock);
    }
    self->task(self->members);
    for (long long i = self->started + 1; i < self->count; ++i)
        self->task(self->members + (size_t)i * self->size);
    if (!self->started) return;
    pthread_mutex_lock(&signals->lock);
    while (signals->left) pthread_cond_wait(&signals->end, &signals->lock);
    pthread_mutex_unlock(&signals->lock);
}

static inline void crew_end(Crew *self) {
    if (!self->hands) return;
    Signals *signals = (Signals *)(self->hands + self->count - 1);
    pthread_mutex_lock(&signals->lock);
    signals->over = 1;
    pthread_cond_broadcast(&signals->begin);
    pthread_mutex_unlock(&signals->lock);
    for (long long i = 0; i < self->started; ++i) pthread_join(self->hands[i].thread, NULL);
    pthread_cond_destroy(&signals->begin);
    pthread_cond_destroy(&signals->end);
    pthread_mutex_destroy(&signals->lock);
    free(self->hands);
}

#endif
#endif
