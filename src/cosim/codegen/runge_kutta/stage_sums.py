"""C code for the weighted stage sums of explicit Runge-Kutta methods."""

from collections.abc import Sequence
from typing import NamedTuple

from cosim.codegen.runge_kutta import dop853
from cosim.codegen.runge_kutta.dop853 import Row


class Arithmetic(NamedTuple):
    """C types of a slope and of a sum, and the format of a weight."""

    slope: str
    sum: str
    weight: str


SCALAR = Arithmetic("const double", "double", "{!r}")
LANES = Arithmetic("V", "V", "every({!r})")  # see fmu/solvers/lanes.h


# C names of the nodes and of the functions for the sums of `dop853`
NAMES = ("pair_node", "pair_stage", "pair_dense", "pair_error_5", "pair_error_3")


def dop853_sums(arithmetic: Arithmetic) -> str:
    """Return the C code of `dop853`: the array of nodes and functions for the sums (`NAMES`)."""
    nodes, stage, dense, error_5, error_3 = NAMES
    return "\n".join(
        (
            numbers(nodes, dop853.NODES),
            sums(stage, dop853.A, arithmetic),
            sums(dense, dop853.DENSE, arithmetic),
            _sum(error_5, dop853.ERROR_5, arithmetic),
            _sum(error_3, dop853.ERROR_3, arithmetic),
        )
    )


def dop853_coefficients() -> str:
    """Return dop853_coefficients.h, the coefficients that fmu/solvers/dop853.h needs."""
    return f"""/* Generated: the coefficients of dop853.h. */
#ifndef DOP853_COEFFICIENTS_H
#define DOP853_COEFFICIENTS_H
#include "dop853.h"
{dop853_sums(SCALAR)}
static const Pair pair = {{
    {", ".join(NAMES)}
}};
#endif
"""


def numbers(name: str, values: Sequence[float]) -> str:
    """Return the definition of an array of constants."""
    return f"static const double {name}[] = {{{', '.join(map(repr, values))}}};"


def sums(name: str, rows: Sequence[Row], arithmetic: Arithmetic = SCALAR) -> str:
    """Return a C function `name(row, k, sum)`: the weighted sum of slopes of a row."""
    cases = "".join(
        f"    case {i}: {_loop(row, arithmetic)} break;\n" for i, row in enumerate(rows)
    )
    slope, total, _ = arithmetic
    return (
        f"static void {name}(int row, {slope} (*k)[NX], {total} *sum) {{\n"
        f"    switch (row) {{\n{cases}    }}\n}}"
    )


def _sum(name: str, row: Row, arithmetic: Arithmetic) -> str:
    head = f"static void {name}({arithmetic.slope} (*k)[NX], {arithmetic.sum} *sum)"
    return f"{head} {{ {_loop(row, arithmetic)} }}"


def _loop(row: Row, arithmetic: Arithmetic) -> str:
    weights = ((stage, arithmetic.weight.format(weight)) for stage, weight in row)
    terms = " + ".join(f"{weight} * k[{stage - 1}][i]" for stage, weight in weights)
    return f"for (int i = 0; i < NX; ++i) sum[i] = {terms or arithmetic.weight.format(0)};"
