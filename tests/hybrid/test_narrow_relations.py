"""Relations that are true for a small part of a step, against the times of a pendulum's motion."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import fmpy
import numpy as np
import pytest

import cosim
from casadi_models.dae import Dae, Model

SPAN, PLACE = 20.0, 0.5
WIDTHS = (1e-2, 1e-4)
Condition = Callable[[Any, Any, Any, Any], Any]  # of place, speed, width and a module of functions
CONDITIONS: dict[str, Condition] = {
    "between": lambda x, _, w, __: (x - PLACE) ** 2 < w**2,
    "bump": lambda x, _, w, m: m.exp(-(((x - PLACE) / w) ** 2)) > 0.5,
    "often": lambda x, _, w, m: m.sin(40 * x) > 1 - w,
    "peak": lambda x, _, w, __: x > 1 - w,
    "in two states": lambda x, v, w, _: (x - 0.6) ** 2 + (v - 0.8) ** 2 < w**2,
}


def pendulum(condition: Condition) -> Dae:
    """Return a model that counts how often a condition becomes true, and for how many widths."""
    model = Model("narrow", stop_time=SPAN, output_interval=0.5)
    x, v = model.state("x", "1", 0.0, "place"), model.state("v", "1/s", 1.0, "speed")
    y, n = model.state("y", "s", 0.0, "time / width"), model.discrete("n", "1", 0.0, "count")
    w = model.parameter("w", "1", 0.01, "width")
    model.derivative(x, v)
    model.derivative(v, -x)
    truth = condition(x, v, w, ca)
    model.derivative(y, ca.if_else(truth, 1 / w, 0.0))
    model.when(truth, {n: n + 1}, name="in")
    return model.freeze()


def expected(condition: Condition, width: float) -> tuple[int, float]:
    """Return the count and the time by samples that resolve a tenth of the shortest excursion."""
    count, spent = 0, 0.0
    for begin in np.arange(0, SPAN):
        t = np.linspace(begin, begin + 1, 400_001)
        true = condition(np.sin(t), np.cos(t), width, np)
        count += int((np.diff(true.astype(int)) == 1).sum())
        spent += float(true[:-1].mean()) / width
    return count, spent


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(
    "between-dop853",
    "bump-cvodes",
    "bump-dop853",
    "bump-erk",
    "often-cvodes",
    "often-erk",
    "between-rk4",
    "bump-ode8",
    "bump-rk4",
    "in two states-dop853",
    "often-dop853",
    "often-ode8",
    "often-rk4",
)
@pytest.mark.parametrize("solver", ["dop853", "rk4", "ode8", "cvodes", "erk"])
@pytest.mark.parametrize("kind", CONDITIONS)
def test_no_solver_steps_over_a_narrow_relation(kind: str, solver: str) -> None:
    condition = CONDITIONS[kind]
    steps = {"step_size": 0.02} if solver in ("rk4", "ode8") else {}
    for width in WIDTHS:
        run = cosim.simulate(pendulum(condition), start_values={"w": width}, solver=solver, **steps)
        count, spent = expected(condition, width)
        assert run.final["n"] == count
        assert run.final["y"] == pytest.approx(spent, rel=0.02)


@pytest.mark.parametrize("solver", ["dop853", "rk4", "cvodes"])
def test_the_first_of_two_excursions_within_a_step_is_the_event(solver: str) -> None:
    model = Model("two", stop_time=10.0, output_interval=5.0)
    x, n = model.state("x", "1", 0.0, "time"), model.discrete("n", "1", 0.0, "count")
    place = model.parameter("place", "1", 0.1, "of the narrow excursion")
    model.derivative(x, 1)
    model.when(((x - place) ** 2 - 1e-8) * (0.9 - x) < 0, {n: n + 1}, name="in")
    dae = model.freeze()
    steps = {"step_size": 5.0} if solver == "rk4" else {}
    for where in np.linspace(0.05, 0.85, 9):
        run = cosim.simulate(dae, solver=solver, start_values={"place": where}, **steps)
        assert [e.time for e in run.events] == pytest.approx([where - 1e-4, 0.9], abs=1e-9)


@pytest.mark.slow_rows("bump-dop853", "bump-rosenbrock", "between-dop853", "often-dop853")
@pytest.mark.parametrize(
    ("kind", "solver"), [*((kind, "dop853") for kind in CONDITIONS), ("bump", "rosenbrock")]
)
def test_co_simulation_does_not_step_over_a_narrow_relation(
    kind: str, solver: str, tmp_path: Any
) -> None:
    condition = CONDITIONS[kind]
    path = cosim.export_fmu(pendulum(condition), tmp_path / "narrow.fmu", solver=solver)
    for width in WIDTHS:
        rows = fmpy.simulate_fmu(
            path,
            fmi_type="CoSimulation",
            stop_time=SPAN,
            output_interval=0.5,
            start_values={"w": width},
            output=["n", "y"],
        )
        count, spent = expected(condition, width)
        assert rows["n"][-1] == count
        assert rows["y"][-1] == pytest.approx(spent, rel=0.02)


SHALLOW, STEP = 4e-6, 0.3  # depth: cubics through the ends of a step are off by more, rk4 by less


def rotation(kind: str) -> tuple[Dae, float]:
    """Return x = sin t, v = cos t with a shallow excursion within a step, and when it begins."""
    model = Model("shallow", stop_time=2.1, output_interval=STEP)
    x, v = model.state("x", "1", 0.0, "sine"), model.state("v", "1", 1.0, "cosine")
    n = model.discrete("n", "1", 0.0, "count")
    model.derivative(x, ca.cos(model.t))
    model.derivative(v, -ca.sin(model.t))
    true, begin = {
        "one state": (x > 1 - SHALLOW, np.arcsin(1 - SHALLOW)),
        "a product": (x * v > 0.5 - SHALLOW, np.arcsin(1 - 2 * SHALLOW) / 2),
    }[kind]
    model.when(true, {n: n + 1}, name="in")
    return model.freeze(), float(begin)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("backend", ["native", "CoSimulation"])
@pytest.mark.parametrize(("solver", "error"), [("ode8", 1e-9), ("rk4", 1.5e-3)])
@pytest.mark.parametrize("kind", ["one state", "a product"])
def test_fixed_steps_do_not_pass_over_what_their_cubics_miss(
    kind: str, solver: str, error: float, backend: str, tmp_path: Path
) -> None:
    dae, begin = rotation(kind)
    if backend == "native":
        run = cosim.simulate(dae, solver=solver, step_size=STEP)
    else:
        path = cosim.export_fmu(dae, tmp_path / "it.fmu", solver=solver, step_size=STEP)
        run = cosim.simulate_fmu(path, interface="CoSimulation")
    assert [event.time for event in run.events] == pytest.approx([begin], abs=error)


@pytest.mark.slow_rows(
    "bump-2", "bump-3", "in two states-3", "often-3", "between-3", "often-2", "peak-3"
)
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", CONDITIONS)
def test_model_exchange_does_not_step_over_a_narrow_relation(
    kind: str, fmi: Literal[2, 3], tmp_path: Path
) -> None:
    condition = CONDITIONS[kind]
    path = cosim.export_fmu(pendulum(condition), tmp_path / "narrow.fmu", fmi=fmi)
    for width, master in zip(WIDTHS, ("c", "fmpy"), strict=True):
        run = cosim.simulate_fmu(
            path, interface="ModelExchange", master=master, start_values={"w": width}
        )
        count, spent = expected(condition, width)
        assert run.final["n"] == count
        assert run.final["y"] == pytest.approx(spent, rel=0.02)


def test_importer_that_locates_no_events_is_warned_once(tmp_path: Path) -> None:
    path = cosim.export_fmu(pendulum(CONDITIONS["between"]), tmp_path / "narrow.fmu")
    log: list[bytes] = []
    fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        solver="Euler",
        stop_time=SPAN,
        output_interval=0.01,  # the step, too
        start_values={"w": 1e-4},
        debug_logging=True,
        logger=lambda *arguments: log.append(arguments[-1]),
    )
    assert sum(b"and returns within a step of the importer" in text for text in log) == 1


def entries(k: float, a: float, w: float) -> list[float]:
    """Return when sin(k sin t + a) rises above 1 - w, up to 6 s."""
    first = np.arcsin(1 - w)
    found = list[float]()
    for turn in 2 * np.pi * np.arange(-20, 21):
        low, high = (first - a + turn) / k, (np.pi - first - a + turn) / k
        rising = [np.arcsin(low)] if abs(low) < 1 else []
        falling = [np.pi - np.arcsin(high)] if abs(high) < 1 else []
        found += [t + shift for t in (*rising, *falling) for shift in (0, 2 * np.pi)]
    return sorted(t for t in found if 0 < t < 6)


@pytest.mark.quick_rows("dop853")
@pytest.mark.parametrize("solver", ["dop853", "rk4", "ode8", "cvodes", "erk", "fmu"])
def test_relations_that_no_law_needs_are_met_in_long_steps(solver: str, tmp_path: Path) -> None:
    model = Model("waves", stop_time=6.0, output_interval=0.5)
    x, v = model.state("x", "1", 0.0, "place"), model.state("v", "1/s", 1.0, "speed")
    n = model.discrete("n", "1", 0.0, "count")
    k, a, w = (model.parameter(name, "1", 1.0, name) for name in "kaw")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.when(ca.sin(k * x + a) > 1 - w, {n: n + 1}, name="in")
    dae = model.freeze()
    path = cosim.export_fmu(dae, tmp_path / "waves.fmu") if solver == "fmu" else None
    steps = {"step_size": 0.02} if solver in ("rk4", "ode8") else {}
    draw = np.random.default_rng(3)
    for _ in range(20):
        values = {
            "k": draw.uniform(5, 80),
            "a": draw.uniform(-3, 3),
            "w": 10 ** draw.uniform(-4, -2),
        }
        if path:
            run = cosim.simulate_fmu(path, start_values=values, relative_tolerance=1e-8)
        else:
            run = cosim.simulate(dae, solver=solver, start_values=values, **steps)
        times = [event.time for event in run.events if event.name == "in"]
        assert times == pytest.approx(entries(**values), abs=2e-5)  # before, some with dop853
