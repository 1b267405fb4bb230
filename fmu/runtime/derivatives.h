/* Derivatives of results; an FMU may have been exported without them. */
#ifndef DERIVATIVES_H
#define DERIVATIVES_H

#include "logging.h"

#if NO_DERIVATIVES
static Status directional(Instance *self, const Reference unknowns[], size_t n_unknowns,
                          const Reference knowns[], size_t n_knowns, const double seed[],
                          double sensitivity[]) {
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)sensitivity;
    return refuse(self, ERROR, "the FMU was exported without derivatives");
}

static Status get_rates(Instance *self, const Reference references[], size_t count,
                        const Order orders[], double values[]) {
    (void)orders;
    return count ? directional(self, references, count, NULL, 0, NULL, values) : OK;
}
#else
#include "output_rates.h"
#include "sensitivity.h"
#endif

#endif
