"""Weighted sums of the slopes of an explicit Runge-Kutta method, as straight-line C code."""

from collections.abc import Sequence
from typing import NamedTuple

from cosim.codegen.runge_kutta import dop853
from cosim.codegen.runge_kutta.dop853 import Row


class Arithmetic(NamedTuple):
    """What is summed: C types of a slope and of the sum, and how a weight is written."""

    slope: str
    sum: str
    weight: str


SCALAR = Arithmetic("const double", "double", "{!r}")
LANES = Arithmetic("V", "V", "every({!r})")  # see fmu/solvers/lanes.h


class Names(NamedTuple):
    """What the parts of `dop853` are called in C."""

    nodes: str
    stage: str
    dense: str
    error_5: str
    error_3: str


def dop853_sums(names: Names, arithmetic: Arithmetic) -> str:
    """Return the coefficients of `dop853` as C: the array of nodes, a function for each sum."""
    return "\n".join(
        (
            numbers(names.nodes, dop853.NODES),
            sums(names.stage, dop853.A, arithmetic),
            sums(names.dense, dop853.DENSE, arithmetic),
            _sum(names.error_5, dop853.ERROR_5, arithmetic),
            _sum(names.error_3, dop853.ERROR_3, arithmetic),
        )
    )


def dop853_coefficients() -> str:
    """Return dop853_coefficients.h: what fmu/solvers/dop853.h wants beside it."""
    names = Names("pair_node", "pair_stage", "pair_dense", "pair_error_5", "pair_error_3")
    return "\n".join(
        (
            "/* Generated: the coefficients of dop853.h. */",
            "#ifndef DOP853_COEFFICIENTS_H",
            "#define DOP853_COEFFICIENTS_H",
            '#include "dop853.h"',
            dop853_sums(names, SCALAR),
            "static const Pair pair = {",
            f"    {', '.join(names)}",
            "};",
            "#endif\n",
        )
    )


def numbers(name: str, values: Sequence[float]) -> str:
    """Return the definition of an array of constants."""
    return f"static const double {name}[] = {{{', '.join(map(repr, values))}}};"


def sums(name: str, rows: Sequence[Row], arithmetic: Arithmetic = SCALAR) -> str:
    """Return a function `name(row, k, sum)`: of each row the weighted sum of slopes."""
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
