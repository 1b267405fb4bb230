"""Which states move by themselves along a path, and may thus grow unseen."""

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.model.state_path import StatePath


def path_of(slopes, grows=None):
    """Return a path of 4 rows at rest, with these slopes."""
    count = len(slopes)
    return StatePath(
        [f"x{i}" for i in range(count)],
        np.arange(4.0),
        np.zeros((count, 4)),
        np.ones(count),
        lambda times, states: np.zeros_like(states),
        lambda times, states: np.broadcast_to(slopes, (len(times), count, count)),
        np.ones(count, dtype=bool) if grows is None else np.array(grows),
    )


@pytest.mark.parametrize(
    ("slopes", "groups"),
    [
        ([[1.0]], ["1"]),
        ([[0, 1], [-4, 0]], ["11"]),
        ([[2, 0], [1, 3]], ["10", "11"]),  # the second one depends on the first
        ([[2, 1e-9], [0, 3]], ["10", "01"]),  # a weak influence is none
        ([[0, 1, 0], [0, 0, 1], [1, 0, 0]], ["111"]),
        ([[0, 1, 0, 0], [1, 0, 0, 0], [1, 0, 0, 1], [0, 0, 1, 0]], ["1100", "1111"]),
        ([[np.nan, 5], [5, 0]], ["11"]),
    ],
)
def test_groups_are_what_states_depend_on(slopes, groups):
    found = ["".join(str(int(own)) for own in group) for group in path_of(np.array(slopes)).groups]
    assert sorted(found) == sorted(groups)


def test_states_that_do_not_grow_make_no_groups():
    assert len(path_of(np.eye(3), [True, False, True]).groups) == 2


def test_without_a_state_that_grows_no_group_is_a_line():
    path = path_of(np.eye(2), [False, False])
    assert path.alone(np.ones((2, 3), dtype=bool)).shape == (0, 3)


def test_the_eigenvalues_of_a_long_chain_that_moves_are_not_asked_for(monkeypatch):
    """All its states depend on one that moves; 200 of them took 13 s of a run of 4 ms."""
    model = cosim.Model("chain", stop_time=2.0, output_interval=0.1)
    x = [model.state(f"x{i}", "m", 0.1 * (i == 0), "position") for i in range(20)]
    v = [model.state(f"v{i}", "m/s", 0.0, "speed") for i in range(20)]
    gaps = [-x[0], *(a - b for a, b in pairwise(x)), x[-1]]
    forces = [100 * gap + 50 * gap**3 for gap in gaps]
    for i in range(20):
        model.derivative(x[i], v[i])
        model.derivative(v[i], forces[i] - forces[i + 1] - 0.1 * v[i])
    asked = list[int]()
    usual = np.linalg.eigvals
    monkeypatch.setattr(np.linalg, "eigvals", lambda own: asked.append(len(own)) or usual(own))
    cosim.simulate(model.freeze(), solver="dop853")
    assert sum(asked) == 0


def test_growth_that_a_moving_state_hardly_pushes_is_followed():
    """An upright pendulum beside a machine that shakes it by 1e-9 of its motion."""
    model = cosim.Model("shaken", stop_time=40.0, output_interval=0.2)
    y, w = model.state("y", "1", 1.0, "machine"), model.state("w", "1/s", 0.0, "its rate")
    x, v = model.state("x", "rad", 0.0, "angle"), model.state("v", "rad/s", 0.0, "rate")
    model.derivative(y, w)
    model.derivative(w, -4 * y)
    model.derivative(x, v)
    model.derivative(v, ca.sin(x) - 0.1 * v + 1e-9 * y)
    dae = model.freeze()
    exact = cosim.simulate(dae, solver="dop853", relative_tolerance=1e-12, absolute_tolerance=1e-20)
    run = cosim.simulate(dae, solver="cvodes")
    assert run.final["x"] == pytest.approx(exact.final["x"], abs=1e-6)
    assert "so that it is followed" in run.stats["note"]
