/* Variables of every kind as doubles: what a run records, and what parts get. */
#ifndef RECORDING_H
#define RECORDING_H

#include <math.h>
#include <stdint.h>

#include "fmu.h"

/* Kinds of variables, in the order of `KINDS` in cosim/fmi/run/c_structures.py. */
enum { F64, F32, I8, U8, I16, U16, I32, U32, I64, U64, B8, TEXT };

#define EXACT (0x1p53 - 1) /* doubles up to it hold every integer */

/* The least and the greatest number of the kinds that are no reals. */
static const double RANGES[][2] = {[I8] = {INT8_MIN, INT8_MAX},    [U8] = {0, UINT8_MAX},
                                   [I16] = {INT16_MIN, INT16_MAX}, [U16] = {0, UINT16_MAX},
                                   [I32] = {INT32_MIN, INT32_MAX}, [U32] = {0, UINT32_MAX},
                                   [I64] = {-EXACT, EXACT},        [U64] = {0, EXACT},
                                   [B8] = {-EXACT, EXACT},         [TEXT] = {0, EXACT}};

/* Variables of one kind, `count` of them with `values` numbers, as arrays have several; `buffer`
 * holds the numbers as they come. */
typedef struct {
    long long kind, count, values;
    const uint32_t *references;
    int (*get_2)(void *, const uint32_t *, size_t, void *);
    int (*get_3)(void *, const uint32_t *, size_t, void *, size_t);
    int (*set_2)(void *, const uint32_t *, size_t, const void *);
    int (*set_3)(void *, const uint32_t *, size_t, const void *, size_t);
    const char *function, *setter; /* their names */
    void *buffer;
} Group;

/* A row per output time; `columns` says where in a row the values of each group belong, or below 0
 * that they do not. Rows of other numbers of the same variables may be used as well. */
typedef struct {
    long long groups, width;
    const Group *group;
    const long long *columns;
    double *rows;
} Recording;

static inline double number(Fmu *fmu, const Group *group, long long i) {
    switch (group->kind) {
    case TEXT: return number_of_text(fmu->texts, ((const char **)group->buffer)[i]);
    case F32: return ((const float *)group->buffer)[i];
    case I8: return ((const int8_t *)group->buffer)[i];
    case U8: return ((const uint8_t *)group->buffer)[i];
    case I16: return ((const int16_t *)group->buffer)[i];
    case U16: return ((const uint16_t *)group->buffer)[i];
    case I32: return ((const int32_t *)group->buffer)[i];
    case U32: return ((const uint32_t *)group->buffer)[i];
    case I64: return (double)((const int64_t *)group->buffer)[i];
    case U64: return (double)((const uint64_t *)group->buffer)[i];
    case B8: return ((const bool *)group->buffer)[i];
    default: return ((const double *)group->buffer)[i];
    }
}

static inline void put_number(Fmu *fmu, const Group *group, long long i, double value) {
    switch (group->kind) {
    case TEXT: ((const char **)group->buffer)[i] = text_of_number(fmu->texts, value); break;
    case F32: ((float *)group->buffer)[i] = (float)value; break;
    case I8: ((int8_t *)group->buffer)[i] = (int8_t)value; break;
    case U8: ((uint8_t *)group->buffer)[i] = (uint8_t)value; break;
    case I16: ((int16_t *)group->buffer)[i] = (int16_t)value; break;
    case U16: ((uint16_t *)group->buffer)[i] = (uint16_t)value; break;
    case I32: ((int32_t *)group->buffer)[i] = (int32_t)value; break;
    case U32: ((uint32_t *)group->buffer)[i] = (uint32_t)value; break;
    case I64: ((int64_t *)group->buffer)[i] = (int64_t)value; break;
    case U64: ((uint64_t *)group->buffer)[i] = (uint64_t)value; break;
    case B8: ((bool *)group->buffer)[i] = value != 0; break;
    default: ((double *)group->buffer)[i] = value;
    }
}

/* Gets a row of what the FMU says now. Returns 0 unless a call fails. */
static inline int get_row(Fmu *fmu, const Recording *self, double *out) {
    const long long *column = self->columns;
    for (long long g = 0; g < self->groups; ++g) {
        const Group *group = self->group + g;
        const size_t n = (size_t)group->count, values = (size_t)group->values;
        void *const instance = fmu->call->instance;
        const int status =
            group->get_2 ? group->get_2(instance, group->references, n, group->buffer)
                         : group->get_3(instance, group->references, n, group->buffer, values);
        if (failed(fmu, group->function, status)) return 1;
        for (long long i = 0; i < group->values; ++i, ++column) {
            if (*column < 0) continue;
            out[*column] = number(fmu, group, i);
            if (group->kind == TEXT && out[*column] < 0)
                return failed(fmu, "remembering a text", FAILED);
        }
    }
    return 0;
}

/* Sets a row; the buffers hold other elements of its arrays. Returns 0 unless a call fails. */
static inline int set_row(Fmu *fmu, const Recording *self, const double *in) {
    const long long *column = self->columns;
    for (long long g = 0; g < self->groups; ++g) {
        const Group *group = self->group + g;
        const size_t n = (size_t)group->count, values = (size_t)group->values;
        void *const instance = fmu->call->instance;
        for (long long i = 0; i < group->values; ++i, ++column) {
            if (*column < 0) continue;
            const double *range = RANGES[group->kind], value = in[*column];
            if (group->kind > F32 && !(value >= range[0] && value <= range[1]))
                return failed(fmu, "setting an integer that its type does not hold", FAILED);
            put_number(fmu, group, i, value);
        }
        const int status =
            group->set_2 ? group->set_2(instance, group->references, n, group->buffer)
                         : group->set_3(instance, group->references, n, group->buffer, values);
        if (failed(fmu, group->setter, status)) return 1;
    }
    return 0;
}

/* Writes a row of what the FMU says now. Returns 0 unless a call fails. */
static inline int record(Fmu *fmu, const Recording *self, long long row) {
    return get_row(fmu, self, self->rows + row * self->width);
}

#endif
