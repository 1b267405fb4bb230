/* Random calls: seeded arguments, sensible and senseless, and the loop that makes the calls.
   Whatever has a state is a thread's own: several may call at once, each its own instances. */
#ifndef FUZZ_H
#define FUZZ_H

#include <float.h>
#include <math.h>
#include <pthread.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "variables.h"

enum { INSTANCES = 4, SNAPSHOTS = 3, MOST = NX > 12 ? NX : 12 /* length of argument arrays */ };

static _Thread_local uint64_t random_state;

/* SplitMix64 (Steele, Lea, Flood, 2014). */
static inline uint64_t next_random(void) {
    uint64_t z = random_state += UINT64_C(0x9e3779b97f4a7c15);
    z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
    return z ^ z >> 31;
}

static inline unsigned below(unsigned bound) {
    return bound ? (unsigned)(next_random() % bound) : 0;
}

static inline int one_in(unsigned n) {
    return below(n) == 0;
}

static inline double uniform(double low, double high) {
    return low + (high - low) * (double)(next_random() >> 11) * 0x1p-53;
}

/* Mostly ordinary numbers; one in five is at or beyond the edge of what numbers can be. */
static inline double some_real(void) {
    static const double edges[] = {0.0,      -0.0,     NAN,     INFINITY,   -INFINITY, DBL_MAX,
                                   DBL_MIN,  4.9e-324, 1e300,   -1e300,     1e-300,    1e16,
                                   -DBL_MAX, 1e-16,    -1e-300, DBL_EPSILON};
    return one_in(5) ? edges[below(sizeof edges / sizeof *edges)] : uniform(-2, 2);
}

static inline uint32_t some_reference(void) {
    static const uint32_t wild[] = {N_VARIABLES, N_VARIABLES + 1, INT32_MAX, UINT32_MAX,
                                    UINT32_C(1) << 31};
    return one_in(30) ? wild[below(5)] : below(N_VARIABLES);
}

static inline size_t some_length(void) {
    static const size_t wild[] = {0, NX - 1, NX + 1, SIZE_MAX, SIZE_MAX / 2, SIZE_MAX / 8 + 1};
    return one_in(6) ? wild[below(6)] : NX;
}

/* Arguments in blocks of their own, so that the sanitizer sees every step beyond an end. */
typedef struct {
    size_t n, m; /* used lengths of references, others and values */
    uint32_t *references, *others;
    int32_t *orders;
    double *values, *results;
} Arguments;

static inline Arguments some_arguments(void) {
    Arguments a = {.n = below(MOST + 1), .m = below(MOST + 1)};
    a.references = one_in(40) ? NULL : malloc(a.n * sizeof *a.references + 1);
    a.others = one_in(40) ? NULL : malloc(a.m * sizeof *a.others + 1);
    a.orders = one_in(40) ? NULL : malloc(MOST * sizeof *a.orders);
    a.values = one_in(40) ? NULL : malloc(MOST * sizeof *a.values);
    a.results = one_in(40) ? NULL : malloc(MOST * sizeof *a.results);
    const unsigned role = one_in(2) ? FIRST_INPUT : 0; /* else few lists were of inputs only */
    for (size_t i = 0; a.references && i < a.n; i++)
        a.references[i] = role ? role + below(NU) : some_reference();
    for (size_t i = 0; a.others && i < a.m; i++) a.others[i] = some_reference();
    for (size_t i = 0; a.orders && i < MOST; i++) a.orders[i] = one_in(9) ? (int)below(9) - 4 : 1;
    for (size_t i = 0; a.values && i < MOST; i++) a.values[i] = some_real();
    for (size_t i = 0; a.results && i < MOST; i++) a.results[i] = 0;
    return a;
}

static inline void drop_arguments(Arguments *a) {
    free(a->references);
    free(a->others);
    free(a->orders);
    free(a->values);
    free(a->results);
}

static inline double seconds(void) { /* of this thread alone */
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static inline void demand(int condition, const char *what) {
    if (condition) return;
    fprintf(stderr, "violated: %s\n", what);
    abort();
}

static inline void demand_finite(const double values[], size_t count) {
    for (size_t i = 0; i < count; i++) demand(isfinite(values[i]), "finite results if all is OK");
}

/* What differs between the versions of the FMI; statuses are numbered alike. */
typedef struct {
    unsigned functions;
    int (*call)(unsigned function, unsigned instance, Arguments *arguments);
    void (*create)(unsigned instance); /* unless there is one */
    void (*destroy)(unsigned instance);
    void (*lead_on)(unsigned instance); /* from where an error has left it */
    void (*settle)(void);               /* demands of what is left in the end */
} Interface;

typedef struct {
    const Interface *interface;
    uint64_t seed;
    long calls, fine;
    double longest; /* call, s */
} Share;

static inline void *make_calls(void *argument) {
    Share *share = argument;
    const Interface *interface = share->interface;
    long refused = 0;
    double begin = seconds(); /* the clock costs as much as a call: it is asked once for each */
    random_state = share->seed;
    for (long i = 0; i < share->calls; i++) {
        const unsigned k = below(INSTANCES);
        if (one_in(500)) interface->destroy(k);
        interface->create(k);
        Arguments a = some_arguments();
        const int status = interface->call(below(interface->functions), k, &a);
        const double end = seconds();
        share->longest = fmax(share->longest, end - begin);
        begin = end;
        share->fine += status == 0;
        refused += status > 1;
        if (status == 3 && one_in(2)) interface->lead_on(k);
        drop_arguments(&a);
    }
    for (unsigned k = 0; k < INSTANCES; k++) interface->destroy(k);
    demand(share->fine > share->calls / 5 && refused > share->calls / 10,
           "a mixture of right and wrong calls");
    interface->settle();
    return NULL;
}

/* SEED CALLS [THREADS] of the command line: make the calls, in that many threads at once; print
   how many there were, how many were OK and the longest, in s. */
static inline int fuzz(int argc, char *argv[], const Interface *interface) {
    demand(argc == 3 || argc == 4, "usage: PROGRAM SEED CALLS [THREADS]");
    const uint64_t seed = strtoull(argv[1], NULL, 10);
    const long calls = strtol(argv[2], NULL, 10),
               threads = argc == 4 ? strtol(argv[3], NULL, 10) : 1;
    Share *shares = malloc((size_t)threads * sizeof *shares); /* calloc may be made to fail */
    pthread_t *thread = malloc((size_t)threads * sizeof *thread);
    demand(shares && thread, "memory");
    for (long i = 0; i < threads; i++) {
        shares[i] = (Share){
            .interface = interface, .seed = seed * 1000 + (uint64_t)i, .calls = calls / threads};
        demand(pthread_create(&thread[i], NULL, make_calls, &shares[i]) == 0, "a thread");
    }
    long made = 0, fine = 0;
    double longest = 0;
    for (long i = 0; i < threads; i++) {
        pthread_join(thread[i], NULL);
        made += shares[i].calls;
        fine += shares[i].fine;
        longest = fmax(longest, shares[i].longest);
    }
    free(thread);
    free(shares);
    printf("%ld %ld %.3f\n", made, fine, longest);
    return 0;
}

#endif
