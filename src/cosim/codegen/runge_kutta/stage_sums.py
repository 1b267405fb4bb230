"""Weighted sums of the slopes of an explicit Runge-Kutta method, as straight-line C code."""

from collections.abc import Sequence

from cosim.codegen.runge_kutta import dop853


def dop853_coefficients() -> str:
    """Return dop853_coefficients.h: what fmu/solvers/dop853.h wants beside it."""
    return "\n".join(
        (
            "/* Generated: the coefficients of dop853.h. */",
            "#ifndef DOP853_COEFFICIENTS_H",
            "#define DOP853_COEFFICIENTS_H",
            '#include "dop853.h"',
            numbers("pair_node", dop853.NODES),
            sums("pair_stage", dop853.A),
            sums("pair_dense", dop853.DENSE),
            _sum("pair_error_5", dop853.ERROR_5),
            _sum("pair_error_3", dop853.ERROR_3),
            "static const Pair pair = {",
            "    pair_node, pair_stage, pair_dense, pair_error_5, pair_error_3",
            "};",
            "#endif\n",
        )
    )


def numbers(name: str, values: Sequence[float]) -> str:
    """Return the definition of an array of constants."""
    return f"static const double {name}[] = {{{', '.join(map(repr, values))}}};"


def sums(name: str, rows: Sequence[Sequence[tuple[int, float]]]) -> str:
    """Return a function `name(row, k, sum)`: of each row (stage, weight) the sum, stages from 1."""
    cases = "".join(f"    case {i}: {_loop(row)} break;\n" for i, row in enumerate(rows))
    return (
        f"static void {name}(int row, const double (*k)[NX], double *sum) {{\n"
        f"    switch (row) {{\n{cases}    }}\n}}"
    )


def _sum(name: str, row: Sequence[tuple[int, float]]) -> str:
    return f"static void {name}(const double (*k)[NX], double *sum) {{ {_loop(row)} }}"


def _loop(row: Sequence[tuple[int, float]]) -> str:
    terms = " + ".join(f"{weight!r} * k[{stage - 1}][i]" for stage, weight in row) or "0"
    return f"for (int i = 0; i < NX; ++i) sum[i] = {terms};"
