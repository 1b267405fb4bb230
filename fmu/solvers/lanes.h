/* Vectors of doubles, one system in each lane, and the functions that equations are made of.
 *
 * GCC's and Clang's vector types; every operation works on each lane by itself, so that what a
 * lane computes depends on nothing in its neighbors. LANES is the number of lanes, 1 to 8.
 */
#ifndef LANES_H
#define LANES_H

#include <math.h>
#include <string.h>

#ifndef __has_builtin /* GCC before 10 */
#define __has_builtin(name) 0
#endif
#if defined(__GNUC__) && !defined(__clang__)
/* GCC 12 drops stores of vectors that a copy by `rep movs` reads, as it does for some processors.
 */
#pragma GCC optimize("no-dse")
#endif

#ifndef LANES
#error "define LANES, the number of systems side by side, before solvers are included"
#endif

typedef double V __attribute__((vector_size(LANES * 8)));
typedef long long M __attribute__((vector_size(LANES * 8))); /* all bits of a lane, or none */

#define FOR_LANES for (int l = 0; l < LANES; ++l)

/* The same number in every lane. */
static inline V every(double a) {
    V r;
    FOR_LANES r[l] = a;
    return r;
}

static inline V pick(M where, V yes, V no) {
    return (V)((where & (M)yes) | (~where & (M)no));
}
static inline int any(M where) {
    int found = 0;
    FOR_LANES found |= where[l] != 0;
    return found;
}
static inline V truth(M where) {
    return pick(where, every(1), every(0));
}
static inline V magnitude(V a) {
    return (V)((M)a & ~(M)every(-0.0));
}

static inline V with_sign(V a, V b) {
    return (V)(((M)a & ~(M)every(-0.0)) | ((M)b & (M)every(-0.0)));
}

static inline V sign_of(V a) {
    return pick(a < 0, every(-1), pick(a > 0, every(1), a));
}
static inline V smaller(V a, V b) {
    return pick(a < b, a, pick(b == b, b, a));
} /* as fmin */
static inline V larger(V a, V b) {
    return pick(a > b, a, pick(b == b, b, a));
}

/* By built-in functions: <immintrin.h> takes longer to compile than all else of most models. */
static inline V root(V a) {
#if __has_builtin(__builtin_elementwise_sqrt)
    return __builtin_elementwise_sqrt(a);
#elif LANES == 8 && defined(__AVX512F__) && __has_builtin(__builtin_ia32_sqrtpd512_mask)
    return __builtin_ia32_sqrtpd512_mask(a, a, -1, 4); /* all lanes, rounded as set */
#elif LANES == 4 && defined(__AVX__) && __has_builtin(__builtin_ia32_sqrtpd256)
    return __builtin_ia32_sqrtpd256(a);
#else
    FOR_LANES a[l] = sqrt(a[l]);
    return a;
#endif
}

#define ONE_BY_ONE(name)                                                                           \
    static inline V each_##name(V a) {                                                             \
        FOR_LANES a[l] = name(a[l]);                                                               \
        return a;                                                                                  \
    }
#define TWO_BY_TWO(name)                                                                           \
    static inline V each_##name(V a, V b) {                                                        \
        FOR_LANES a[l] = name(a[l], b[l]);                                                         \
        return a;                                                                                  \
    }
ONE_BY_ONE(sin)
ONE_BY_ONE(cos)
ONE_BY_ONE(tan)
ONE_BY_ONE(asin)
ONE_BY_ONE(acos)
ONE_BY_ONE(atan)
ONE_BY_ONE(sinh)
ONE_BY_ONE(cosh)
ONE_BY_ONE(tanh)
ONE_BY_ONE(asinh)
ONE_BY_ONE(acosh)
ONE_BY_ONE(atanh)
ONE_BY_ONE(exp)
ONE_BY_ONE(expm1)
ONE_BY_ONE(log)
ONE_BY_ONE(log1p)
ONE_BY_ONE(erf)
ONE_BY_ONE(floor)
ONE_BY_ONE(ceil)
TWO_BY_TWO(pow)
TWO_BY_TWO(fmod)
TWO_BY_TWO(remainder)
TWO_BY_TWO(atan2)
TWO_BY_TWO(hypot)

/* Equations as generated code has them: columns in, columns out. */
typedef void LaneFunction(const V *const *in, V *const *out);

/* Sine and cosine of a whole vector, where the machine's library has them. */
typedef V Elementary(V);
static Elementary *vector_sin = each_sin, *vector_cos = each_cos;

/* Both of one angle; lane by lane they are taken together, as compilers do with scalar code. */
static inline void sine_and_cosine(V a, V *sine, V *cosine) {
    if (vector_sin == each_sin) {
        FOR_LANES {
            (*sine)[l] = sin(a[l]);
            (*cosine)[l] = cos(a[l]);
        }
    } else {
        *sine = vector_sin(a);
        *cosine = vector_cos(a);
    }
}

#ifdef _WIN32
#define LANES_SHARED __declspec(dllexport)
#else
#define LANES_SHARED __attribute__((visibility("default")))
#endif

LANES_SHARED void lanes_use(Elementary *sine, Elementary *cosine) {
    vector_sin = sine;
    vector_cos = cosine;
}

#endif
