"""Validity conditions that are violated for a small part of a step, against the closed form."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import numpy as np
import pytest
from hybrid.test_narrow_relations import CONDITIONS, SHALLOW, SPAN, STEP, Condition

import cosim
from casadi_models.dae import Dae, Model
from cosim.errors import Interrupted, SolverError
from cosim.integrate import run as native
from cosim.integrate.call import INTERRUPTED

WIDTHS = (1e-2, 1e-4)
NATIVE = ["dop853", "cvodes", "idas", "erk", "rosenbrock", "rk4", "ode8"]
STEPS = {"rk4": {"step_size": 0.02}, "ode8": {"step_size": 0.02}}
MARGINS: dict[str, Condition] = {  # positive while the conditions of CONDITIONS are false
    "between": lambda x, _, w, __: (x - 0.5) ** 2 - w**2,
    "bump": lambda x, _, w, m: 0.5 - m.exp(-(((x - 0.5) / w) ** 2)),
    "often": lambda x, _, w, m: 1 - w - m.sin(40 * x),
    "in two states": lambda x, v, w, _: (x - 0.6) ** 2 + (v - 0.8) ** 2 - w**2,
}


def pendulum(kind: str) -> Dae:
    """Return x = sin t with a limit, and rows that are far apart."""
    model = Model("narrow", stop_time=SPAN, output_interval=0.5)
    x, v = model.state("x", "1", 0.0, "place"), model.state("v", "1/s", 1.0, "speed")
    w = model.parameter("w", "1", 0.01, "width")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.limit(MARGINS[kind](x, v, w, ca), "it is narrow")
    return model.freeze()


def leaves(kind: str, width: float) -> float:
    """Return when the condition becomes true first, by samples 5e-7 s apart."""
    t = np.linspace(0, 1, 2_000_001)
    return float(t[np.argmax(CONDITIONS[kind](np.sin(t), np.cos(t), width, np))])


def expect(stats: Any, kind: str, width: float, within: float = 1e-6) -> None:
    (reason,) = stats["invalid"]
    assert reason.time == pytest.approx(leaves(kind, width), abs=within)


def violated_at(many: Any, i: int) -> float:
    """Return the time that the text of a run's violation begins with, "invalid from 0.5 s"."""
    return float(many.invalid[i].split()[2])


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("between-dop853", "bump-dop853")
@pytest.mark.parametrize("solver", NATIVE)
@pytest.mark.parametrize("kind", MARGINS)
def test_native_run_reports_a_narrow_limit(kind: str, solver: str) -> None:
    dae = pendulum(kind)
    for width in WIDTHS:
        run = cosim.simulate(dae, start_values={"w": width}, solver=solver, **STEPS.get(solver, {}))
        expect(run.stats, kind, width)
        assert len(run) == 41


def test_lanes_report_a_narrow_limit() -> None:
    many = cosim.simulate_many(pendulum("in two states"), {"w": WIDTHS}, solver="dop853")
    assert "lanes" in many.stats
    for i, width in enumerate(WIDTHS):
        assert violated_at(many, i) == pytest.approx(leaves("in two states", width), abs=1e-6)


def test_lanes_report_the_first_of_many_narrow_violations() -> None:
    model = Model("waves", stop_time=6.0, output_interval=0.5)
    x, v = model.state("x", "1", 0.0, "place"), model.state("v", "1/s", 1.0, "speed")
    k, a = model.parameter("k", "1", 30.0, "waves"), model.parameter("a", "1", 0.0, "phase")
    w = model.parameter("w", "1", 1e-3, "depth")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.limit(1 - w - ca.sin(k * x + a), "no peak")
    rng = np.random.default_rng(1)
    runs = {"k": rng.uniform(10, 60, 99), "a": rng.uniform(-3, 1.4, 99)}
    runs["w"] = 10 ** rng.uniform(-7, -2.5, 99)
    many = cosim.simulate_many(model.freeze(), runs, solver="dop853")
    first = np.arcsin((np.pi / 2 - np.arccos(1 - runs["w"]) - runs["a"]) / runs["k"])
    for i, time in enumerate(first):
        assert violated_at(many, i) == pytest.approx(time, abs=1e-5)


def test_a_narrow_limit_of_an_input_is_reported() -> None:
    model = Model("driven", stop_time=6.0, output_interval=0.5)
    x, u = model.state("x", "1", 0.0, "place"), model.input("u", "1", 0.0, "drive")
    w = model.parameter("w", "1", 0.01, "width")
    model.derivative(x, u - x)
    model.limit((u - 0.5) ** 2 - w**2, "it is narrow")
    dae = model.freeze()
    for width in WIDTHS:
        run = cosim.simulate(dae, inputs={"u": "sin(t)"}, start_values={"w": width})
        (reason,) = run.stats["invalid"]
        assert reason.time == pytest.approx(np.arcsin(0.5 - width), abs=1e-9)


@pytest.mark.parametrize("solver", ["dop853", "cvodes", "rk4"])
def test_native_run_ends_at_a_narrow_limit(solver: str) -> None:
    steps = STEPS.get(solver, {})
    with pytest.raises(SolverError, match=r"invalid from 0\.52348\d* s") as caught:
        cosim.simulate(
            pendulum("between"), start_values={"w": 1e-4}, solver=solver, on_invalid="stop", **steps
        )
    assert caught.value.partial is not None
    assert caught.value.partial.time.tolist() == [0.0, 0.5]


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("kind", "solver"),
    [
        *((kind, "dop853") for kind in MARGINS),
        *(("often", solver) for solver in ("erk", "rosenbrock", "rk4", "ode8")),
    ],
)
def test_co_simulation_reports_a_narrow_limit(kind: str, solver: str, tmp_path: Path) -> None:
    steps: Any = {"step_size": 0.05} if solver in STEPS else {}
    path = cosim.export_fmu(pendulum(kind), tmp_path / "narrow.fmu", solver=solver, **steps)
    for width, master in zip(WIDTHS, ("c", "fmpy"), strict=True):
        run = cosim.simulate_fmu(path, master=master, start_values={"w": width})
        expect(run.stats, kind, width)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(("solver", "error"), [("ode8", 1e-9), ("rk4", 1.5e-3)])
@pytest.mark.parametrize("kind", ["one state", "a product"])
def test_fixed_steps_report_what_their_cubics_miss(
    kind: str, solver: str, error: float, tmp_path: Path
) -> None:
    model = Model("shallow", stop_time=2.1, output_interval=STEP)
    x, v = model.state("x", "1", 0.0, "sine"), model.state("v", "1", 1.0, "cosine")
    model.derivative(x, ca.cos(model.t))
    model.derivative(v, -ca.sin(model.t))
    margin, begin = {
        "one state": (1 - SHALLOW - x, np.arcsin(1 - SHALLOW)),
        "a product": (0.5 - SHALLOW - x * v, np.arcsin(1 - 2 * SHALLOW) / 2),
    }[kind]
    model.limit(margin, "it is shallow")
    path = cosim.export_fmu(model.freeze(), tmp_path / "it.fmu", solver=solver, step_size=STEP)
    (reason,) = cosim.simulate_fmu(path, interface="CoSimulation").stats["invalid"]
    assert reason.time == pytest.approx(begin, abs=error)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("in two states-2", "bump-2", "bump-3", "often-3")
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", MARGINS)
def test_model_exchange_reports_a_narrow_limit(
    kind: str, fmi: Literal[2, 3], tmp_path: Path
) -> None:
    path = cosim.export_fmu(pendulum(kind), tmp_path / "narrow.fmu", fmi=fmi)
    for width in WIDTHS:
        for master, within in (("c", 1e-4), ("fmpy", 2e-6)):  # cubics of the importer's steps
            what: Any = {"interface": "ModelExchange", "master": master}
            run = cosim.simulate_fmu(path, start_values={"w": width}, **what)
            expect(run.stats, kind, width, within)


@pytest.mark.parametrize("at", [0, 1])
def test_ctrl_c_keeps_the_rows_and_begins_no_further_integration(
    monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    integrate, calls = native.integrate, []

    def interrupted(*values: Any) -> Any:
        calls.append(values)
        motion = integrate(*values)
        return replace(motion, reason=INTERRUPTED) if len(calls) == at + 1 else motion

    monkeypatch.setattr(native, "integrate", interrupted)
    dae = pendulum("bump")
    with pytest.raises(Interrupted) as caught:
        cosim.simulate(dae, start_values={"w": 1e-4}, output_interval=SPAN / 2)
    assert len(calls) == at + 1
    partial = caught.value.partial
    assert partial is not None
    assert partial.time.tolist() == [0, SPAN / 2, SPAN]
    assert partial.status.endswith("interrupted")


@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_uneven_output_times_hide_no_violation_where_they_are_far_apart(solver: str) -> None:
    model = Model("swinging", stop_time=100.0, output_interval=20.0)
    x, v = model.state("x", "1", 0.0, "place"), model.state("v", "1", 1.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.limit(0.9 - x, "it is near")
    times = [*np.linspace(0, 0.1, 2000), 2 * np.pi]
    run = cosim.simulate(model.freeze(), output_times=times, solver=solver)
    (reason,) = run.stats["invalid"]
    assert reason.time == pytest.approx(np.arcsin(0.9), abs=1e-6)
