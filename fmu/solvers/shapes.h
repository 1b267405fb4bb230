/* Names and sizes of a function of CasADi's interface for external functions:
 *
 *     run(x0, z0, p, u) -> (xf, zf), one column per output time,
 *
 * p = (c, SETTINGS numbers, output times, breaks); u has one column, or one per output time that
 * holds on the way there. How many these are is no constant of the library: `cosim_sizes` must be
 * called before CasADi asks for the sizes.
 */
#ifndef SHAPES_H
#define SHAPES_H

#include <stddef.h>

#include "interrupt.h"
#include "problem.h"

#ifndef SETTINGS
#error "define SETTINGS, how many numbers stand between c and the output times"
#endif

static long long size_x0[3] = {NX, 1, 1}, size_z0[3] = {NZ, 1, 1}, size_u[3] = {NU, 1, 1};
static long long size_p[3] = {0, 1, 1}, size_xf[3] = {NX, 0, 1}, size_zf[3] = {NZ, 0, 1};

SHARED void cosim_sizes(long long points, long long breaks, long long columns) {
    size_p[0] = NC + SETTINGS + points + breaks;
    size_u[1] = columns;
    size_xf[1] = points;
    size_zf[1] = points;
}

SHARED long long run_n_in(void) {
    return 4;
}
SHARED long long run_n_out(void) {
    return 2;
}

SHARED const char *run_name_in(long long i) {
    static const char *const names[] = {"x0", "z0", "p", "u"};
    return i >= 0 && i < 4 ? names[i] : NULL;
}

SHARED const char *run_name_out(long long i) {
    return i == 0 ? "xf" : i == 1 ? "zf" : NULL;
}

SHARED const long long *run_sparsity_in(long long i) {
    const long long *const sizes[] = {size_x0, size_z0, size_p, size_u};
    return i >= 0 && i < 4 ? sizes[i] : NULL;
}

SHARED const long long *run_sparsity_out(long long i) {
    return i == 0 ? size_xf : i == 1 ? size_zf : NULL;
}

#endif
