/* A signal ends a run (Ctrl-C, a time limit, the end of a command): the library takes it over.
 *
 * The run itself looks at `halted` once per step or right-hand side.
 */
#ifndef INTERRUPT_H
#define INTERRUPT_H

#include <signal.h>
#include <stddef.h>
#include <string.h>

#ifdef _WIN32
#define SHARED __declspec(dllexport)
#else
#define SHARED __attribute__((visibility("default")))
#endif

static volatile sig_atomic_t halted;

#ifdef SA_ONSTACK /* of POSIX: what is given back is what it was, flags and all */
typedef struct sigaction Handling;

static void halt(int number) {
    halted = (sig_atomic_t)number;
}

static inline int take_over(int number, Handling *before) {
    struct sigaction own = {.sa_handler = halt, .sa_flags = SA_ONSTACK};
    sigemptyset(&own.sa_mask);
    return sigaction(number, &own, before) == 0;
}

static inline void give_back(int number, const Handling *before) {
    sigaction(number, before, NULL);
}

static inline int is_handled(const Handling *before) {
    return before->sa_handler != SIG_DFL && before->sa_handler != SIG_IGN;
}
#else
typedef void (*Handling)(int);

static void halt(int number) {
    signal(number, halt); /* Windows forgets a handler that was called */
    halted = (sig_atomic_t)number;
}

static inline int take_over(int number, Handling *before) {
    *before = signal(number, halt);
    return *before != SIG_ERR;
}

static inline void give_back(int number, const Handling *before) {
    signal(number, *before);
}

static inline int is_handled(const Handling *before) {
    (void)before; /* what another C runtime handles cannot be seen here */
    return 1;
}
#endif

static const int watched_signals[] = {
    SIGINT,
#ifdef SIGALRM
    SIGALRM,
#endif
    SIGTERM, /* from here on those that end a command */
#ifdef SIGHUP
    SIGHUP,
#endif
};
enum { WATCHED = sizeof watched_signals / sizeof *watched_signals };

static Handling handling_before[WATCHED];
static int taken_over[WATCHED];

/* Lets handled signals end the runs that follow, if these are a command's also those that end it.
 */
SHARED void cosim_watch(int of_command) {
    memset(taken_over, 0, sizeof taken_over);
    for (int i = 0; i < WATCHED && (of_command || watched_signals[i] != SIGTERM); ++i) {
        taken_over[i] = take_over(watched_signals[i], &handling_before[i]);
        if (!taken_over[i] || is_handled(&handling_before[i])) continue;
        give_back(watched_signals[i], &handling_before[i]);
        taken_over[i] = 0;
    }
}

/* Gives them back. Tells by which one a run was ended, 0 for none, and lets the next ones go on. */
SHARED int cosim_halted(void) {
    const int was = (int)halted;
    for (int i = 0; i < WATCHED; ++i)
        if (taken_over[i]) give_back(watched_signals[i], &handling_before[i]);
    halted = 0;
    return was;
}

#endif
