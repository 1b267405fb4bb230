"""Short changes of distances and angles (`hypot`, `atan2`), on every backend."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim

PLACE, SPEED, WIDTH, STOP = np.array([50.3, 15.09]), np.array([10.0, 3.0]), 1e-3, 7.0
FORMS = {  # of what is left to a place, x and y, and functions of a module
    "hill": lambda x, y, m: m.exp(-((m.hypot(x, y) / WIDTH) ** 2)),
    "cone": lambda x, y, m: m.exp(-m.hypot(x, y) / WIDTH),
    "ring": lambda x, y, m: m.exp(-(((m.hypot(x + 9, y + 5) - np.hypot(9, 5)) / WIDTH) ** 2)),
    "well": lambda x, y, m: 1 / (1 + (m.hypot(x, y) / WIDTH) ** 4),
    "kink": lambda x, y, m: m.exp(-m.hypot(x, WIDTH) / WIDTH),
    "ray": lambda x, y, m: m.exp(-(((angle(m)(y + 1, x + 1) - np.pi / 4) / WIDTH) ** 2)),
    "slopes": lambda x, y, m: between((angle(m)(y + 1, x + 1) - np.pi / 4) / WIDTH, m),
    "near a turn": lambda x, y, m: m.exp(-(((angle(m)(x, -2) - 3.1) / WIDTH) ** 2)),
    "turns": lambda x, y, m: m.exp(-(((angle(m)(m.sin(x), m.cos(x)) - 1) / WIDTH) ** 2)),
}
KINDS = ["dop853", "cvodes", "CoSimulation", "ModelExchange"]


def angle(m):
    return np.arctan2 if m is np else m.atan2


def between(c, m):
    return m.tanh(c + 1.5) - m.tanh(c - 1.5)


def over(form):
    """Return a model of a straight way, on which a change adds up."""
    x, y, h = (SX.sym(name) for name in "xyh")
    ode = ca.vertcat(*SPEED, FORMS[form](x - PLACE[0], y - PLACE[1], ca) / WIDTH)
    laws = {"x": ca.vertcat(x, y, h), "ode": ode}
    return cosim.from_casadi(laws, name="over", stop_time=STOP, output_interval=0.5)


def integral(form):
    t = np.linspace(0, STOP, 7_000_001)
    x, y = SPEED[:, None] * t - PLACE[:, None]
    return np.trapezoid(FORMS[form](x, y, np), t) / WIDTH


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("form", FORMS)
def test_no_step_passes_over_it(form, kind, tmp_path, recwarn):
    if kind in ("dop853", "cvodes"):
        run = cosim.simulate(over(form), solver=kind)
    else:
        path = cosim.export_fmu(over(form), tmp_path / "x.fmu")
        run = cosim.simulate_fmu(path, interface=kind)
    assert run["h"][-1] == pytest.approx(integral(form), rel=1e-4)  # before: 0 in 28 of 36
    assert not run.stats.get("note")
    assert not recwarn
