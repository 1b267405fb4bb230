"""Random bumps of a road and pulses of time: which solvers and FMUs pass over them.

    python benchmarks/steps.py [COUNT] [--outputs] [--short]

A mass on a spring and a damper moves over a bump at 10 m/s, or a pulse of time pushes it. Shape,
place and width (0.1 mm to 1 m) are random. A result is right if the height at the end is, to 1 % of
its largest value; it is wrong without a word if it is not, and no note says so.

With `--outputs`, a bump or a pulse is an output on which no state depends, also of a state that
swings. A run is right if its largest value and its mean are, to 0.1 %.
"""

import itertools
import sys
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np
from casadi import SX
from scipy.integrate import solve_ivp

import cosim

SPEED, HEIGHT, STOP = 10.0, 0.05, 7.0  # m/s, m, s
REACH = 12  # widths, beyond which no shape is felt
KNOTS = np.linspace(-10, 10, 201)
TABLE = ca.interpolant("table", "linear", [KNOTS], np.exp(-(KNOTS**2)))
SHAPES = {
    "gauss": lambda c, m: m.exp(-(c**2)),
    "lorentz": lambda c, m: 1 / (1 + c**2) ** 4,
    "slopes": lambda c, m: (m.tanh(c + 1.5) - m.tanh(c - 1.5)) / 2,
    "table": lambda c, m: np.interp(c, KNOTS, np.exp(-(KNOTS**2))) if m is np else TABLE(c),
    "plane": lambda c, m: m.exp(-(c**2)),
    "hill": lambda c, m: m.exp(-2 * c**2),
    "pulse": lambda c, m: m.exp(-(c**2)),
}
SCIPY = ("DOP853", "RK45", "LSODA", "BDF")
CASADI = ("cvodes", "idas", "collocation", "rk")  # its integrators, without this project
NATIVE = ("dop853", "cvodes")
OTHERS = ("cvodes_adams", "idas", "erk", "rosenbrock", "rk4", "ode8")


def model(shape: str) -> cosim.Dae:
    form = SHAPES[shape]
    t, place, width = SX.sym("t"), SX.sym("place"), SX.sym("width")
    s, r, h, v = (SX.sym(name) for name in "srhv")
    c = ((SPEED * t if shape == "pulse" else s) - place) / width
    d = (r - place) / width
    bumps = {"plane": form(c, ca) * form(d, ca), "hill": ca.exp(-(c**2) - d**2)}
    bump = bumps.get(shape, form(c, ca))
    ode = ca.vertcat(SPEED, SPEED, v, -25 * (h - HEIGHT * bump) - v)
    laws = {"t": t, "x": ca.vertcat(s, r, h, v), "ode": ode, "p": ca.vertcat(place, width)}
    start = {"place": 50.0, "width": 0.1}
    return cosim.from_casadi(laws, start, name=shape, stop_time=STOP, output_interval=0.5)


def by_scipy(shape: str, place: float, width: float, method: str, closely: bool) -> float:
    """Return the height at the end; `closely` with short steps near the bump."""

    def slope(t, x):
        c = (SPEED * t - place) / width
        bump = SHAPES[shape](c, np) ** (2 if shape == "plane" else 1)
        return [x[1], -25 * (x[0] - HEIGHT * bump) - x[1]]

    ends = np.clip([0, place - REACH * width, place + REACH * width, STOP * SPEED], 0, 70) / SPEED
    spans = itertools.pairwise(ends) if closely else [(0, STOP)]
    x = np.zeros(2)
    for begin, end in spans:
        longest = 0.1 * width / SPEED if closely and end - begin < 3 * REACH * width else np.inf
        tolerances = {"rtol": 1e-8, "atol": 1e-12} if closely else {"rtol": 1e-8, "atol": 1e-10}
        if begin < end:
            x = solve_ivp(slope, (begin, end), x, method, max_step=longest, **tolerances).y[:, -1]
    return float(x[0])


def by_casadi(dae: cosim.Dae, values: dict[str, float], method: str) -> float:
    """Return the height at the end, by CasADi's integrator with rows of the model's interval."""
    laws = {"t": dae.t, "x": dae.x, "p": dae.p, "ode": dae.ode}
    options = {"reltol": 1e-8, "abstol": 1e-10} if method in ("cvodes", "idas") else {}
    rows = np.linspace(0, STOP, 15)
    whole = ca.integrator("whole", method, laws, 0, rows, options)
    return float(whole(x0=dae.x_start, p=[values[p.name] for p in dae.parameters])["xf"][2, -1])


def outputs(count: int) -> None:
    """Compare largest values and means of bumps that are outputs alone with closed forms."""
    random, wrong = np.random.default_rng(2), dict.fromkeys(NATIVE, 0)
    near = np.linspace(-REACH, REACH, 100_001)
    for k in range(count):
        shape = list(SHAPES)[k % len(SHAPES)]
        form, swings = SHAPES[shape], k % 2 == 0 and shape != "pulse"
        width, place = float(10 ** random.uniform(-4, 0)), float(random.uniform(5, 45))
        t, s, v = (SX.sym(name) for name in "tsv")
        ode = ca.vertcat(v, -s) if swings else ca.vertcat(SPEED, 0)
        c = ((SPEED * t if shape == "pulse" else s) - place) / width
        laws = {"t": t, "x": ca.vertcat(s, v), "ode": ode}
        bump = {"y": form(c, ca)}
        stop = np.pi if swings else 5.0
        dae = cosim.from_casadi(laws, {"v": 50.0}, outputs=bump, stop_time=stop)
        seen, at = form(near, np), place + width * near
        inside = np.sqrt(np.maximum(2500 - at**2, 0))
        speed = np.where(inside > 0, inside / 2, np.inf) if swings else SPEED  # it passes twice
        right = seen.max(), np.trapezoid(seen / speed, at) / stop
        for solver in NATIVE:
            run = cosim.simulate(dae, solver=solver, output_interval=stop / 10).select("y")
            found = run.curves.extremes.high[0], run.curves.mean()[0]
            wrong[solver] += not np.allclose(found, right, rtol=1e-3)
    print(f"of {count} outputs, with a wrong largest value or mean: {wrong}")


def main(count: int) -> None:
    random, folder = np.random.default_rng(1), Path(tempfile.mkdtemp())
    wrong, noted = dict[str, int](), dict[str, int]()
    shapes = list(SHAPES)
    models = {shape: model(shape) for shape in shapes}
    files = {shape: cosim.export_fmu(models[shape], folder / f"{shape}.fmu") for shape in shapes}
    for k in range(count):
        shape, width = shapes[k % len(shapes)], float(10 ** random.uniform(-4, 0))
        place = float(random.uniform(40, 60))
        right = by_scipy(shape, place, width, "DOP853", closely=True)
        area = HEIGHT * width / SPEED * 5  # of the response to an impulse: its largest value
        found = {f"scipy {m}": (by_scipy(shape, place, width, m, False), "") for m in SCIPY}
        values = {"place": place, "width": width}
        for method in CASADI:
            found[f"casadi {method}"] = by_casadi(models[shape], values, method), ""
        for solver in NATIVE + OTHERS:
            run = cosim.simulate(models[shape], solver=solver, start_values=values)
            found[f"cosim {solver}"] = run["h"][-1], run.stats.get("note", "")
        for interface in ("CoSimulation", "ModelExchange"):
            path = files[shape]
            options = {"interface": interface, "start_values": values}
            run = cosim.simulate_fmu(path, relative_tolerance=1e-9, **options)
            found[f"FMU, {interface}"] = run["h"][-1], run.stats.get("note", "")
        for name, (value, note) in found.items():
            off = abs(value - right) > 0.01 * area
            wrong[name] = wrong.get(name, 0) + (off and not note)
            noted[name] = noted.get(name, 0) + bool(off and note)
    print(f"of {count} bumps, passed over without a word (with a note):")
    for name, number in wrong.items():
        print(f"{name:22} {number:4} ({noted[name]})")


if __name__ == "__main__":
    numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
    run = outputs if "--outputs" in sys.argv else main
    run(6 if "--short" in sys.argv else (numbers or [300])[0])
