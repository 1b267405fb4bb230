/* Ctrl-C ends a run: the library takes the signal over, its caller gives it back afterwards.
 *
 * The run itself looks at `halted` once per step or right-hand side.
 */
#ifndef INTERRUPT_H
#define INTERRUPT_H

#include <signal.h>

#ifdef _WIN32
#define SHARED __declspec(dllexport)
#else
#define SHARED __attribute__((visibility("default")))
#endif

static volatile sig_atomic_t halted;

static void halt(int number) {
    signal(number, halt); /* some systems forget a handler that was called */
    halted = 1;
}

SHARED void cosim_watch(void) {
    signal(SIGINT, halt);
}

/* Tells whether runs were ended, and lets the next ones go on. */
SHARED int cosim_halted(void) {
    const int was = halted;
    halted = 0;
    return was;
}

#endif
