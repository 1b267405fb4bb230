"""Weighted sums of the slopes of an explicit Runge-Kutta method, as straight-line C code."""

from collections.abc import Sequence

from cosim.codegen import dop853
from cosim.codegen.c_sources import solver_source


def dop853_text() -> str:
    """Return fmu/solvers/dop853.h behind the coefficients that it wants."""
    return "\n".join(
        (
            numbers("node", dop853.NODES),
            sums("stage_sum", dop853.A),
            sums("dense_sum", dop853.DENSE),
            _sum("error_5", dop853.ERROR_5),
            _sum("error_3", dop853.ERROR_3),
            solver_source("dop853.h"),
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
