"""Where functions bend: by bounds, and by samples in the cells alone that bounds leave open."""

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.codegen.changes import bent_parts
from cosim.codegen.terms import terms_of

CELLS = 1000
EDGES = np.linspace(0.0, 10.0, CELLS + 1)
PLACE, WIDTH = 7.3051, 4e-4  # of a bump that lies between two edges


def bump(at):
    return np.exp(-(((at - PLACE) / WIDTH) ** 2))


def bounds(begins, widths):
    """Return how far the bump is from a line in cells; unknown in those that hold its top."""
    is_near = (begins < PLACE + 5 * WIDTH) & (begins + widths > PLACE - 5 * WIDTH)
    return np.where(is_near, np.nan, 0.0)


@pytest.mark.parametrize("known", [bounds, None])
def test_a_bump_is_found_and_only_cells_without_bounds_are_sampled(known):
    places = []

    def values(at):
        places.append(at)
        return bump(at)

    (edges,) = bent_parts(values, known, EDGES, np.empty(0))
    assert PLACE - 4 * WIDTH < edges[0] < PLACE < edges[-1] < PLACE + 4 * WIDTH
    sampled = np.concatenate(places)
    far = sampled[np.abs(sampled - PLACE) > 0.02]  # two cells
    assert np.isin(far, EDGES).all() == (known is not None)


def test_long_cells_in_which_a_function_is_near_a_line_are_looked_at_as_one():
    """A wave of 200 cells, with a bump between two edges."""
    looked_at = []

    def values(at):
        return np.sin(np.pi * at) + 3 * bump(at)

    def off(begins, widths):
        looked_at.extend(begins)
        of_bump = 3 * np.minimum((widths / WIDTH) ** 2 / 4, 1)
        return (np.pi * widths) ** 2 / 8 + np.where(np.isnan(bounds(begins, widths)), of_bump, 0)

    found = bent_parts(values, off, EDGES, np.empty(0))
    assert [True for edges in found if edges[0] < PLACE < edges[-1]]
    assert all(abs(edges - PLACE).max() < 0.01 for edges in found)
    assert len(looked_at) < CELLS


@pytest.mark.parametrize("kind", ["linear", "bspline"])
def test_a_table_is_sampled_less_and_its_narrow_changes_are_found(kind):
    knots = np.unique(np.concatenate((np.linspace(0, 10, 40), PLACE + WIDTH * np.arange(-8, 9))))
    table = ca.interpolant("table", kind, [knots], bump(knots))
    seen = {True: 0, False: 0}
    found = dict[bool, list]()
    for is_table in seen:

        def values(at, is_table=is_table):
            seen[is_table] += len(at)
            return np.array(table(at)).ravel()

        found[is_table] = bent_parts(values, None, EDGES, knots, is_table=is_table)
    assert seen[True] < seen[False] / 10
    few, many = (np.concatenate(edges) for edges in found.values())
    assert few[[0, -1]] == pytest.approx(many[[0, -1]], abs=WIDTH)


@pytest.mark.parametrize(
    ("argument", "alone"), [(lambda s: 2 * s + 1, True), (lambda s: 5 + 4 * ca.sin(s), False)]
)
def test_a_table_of_a_bent_argument_may_change_between_its_knots(argument, alone):
    knots = np.linspace(0, 10, 21)
    table = ca.interpolant("table", "linear", [knots], np.cos(knots))
    s = ca.MX.sym("s")
    dae = cosim.from_casadi({"x": s, "ode": 1 + table(argument(s))}, name="way")
    (terms,) = terms_of(dae)
    assert terms.alone == (alone,)
