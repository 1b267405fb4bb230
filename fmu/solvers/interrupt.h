/* A signal ends a run (Ctrl-C, a time limit): the library takes it over, its caller gives it back.
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
    halted = (sig_atomic_t)number;
}

SHARED void cosim_watch(int number) {
    signal(number, halt);
}

/* Tells by which signal runs were ended, 0 for none, and lets the next ones go on. */
SHARED int cosim_halted(void) {
    const int was = (int)halted;
    halted = 0;
    return was;
}

#endif
