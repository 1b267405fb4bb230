"""Drift control of the multiplier formulations: remaining drift, error and cost.

Prints the tables of benchmarks/results/drift.md; with `--figure FILE` it only draws the drift
of the long runs.
Times are medians of interleaved repeats of the solver alone, given as ratios to the run without
control. Runs of more than SLOW seconds are not repeated.
"""

import sys
from dataclasses import dataclass, field
from functools import cache
from statistics import median

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import cosim
from casadi_models.dae import Dae
from cosim.colors import CURVES
from cosim.plotting import STYLE, save
from cosim.trajectory import Trajectory

REPEATS = 25
SLOW = 1.0  # s
MONITORS = ("position_drift", "velocity_drift")


@dataclass(frozen=True)
class Case:
    """A run with several kinds of drift control.

    Attributes:
        model: A formulation with multipliers.
        values: Start values and parameters.
        stop_time, output_interval: s.
        truth: A formulation that cannot drift, for the comparison.
        compared: Names of the compared outputs; empty if the run is too long for a comparison.
        energy: Whether energy is constant.
    """

    model: str
    stop_time: float
    output_interval: float = 0.01
    values: dict[str, float] = field(default_factory=dict)
    truth: str = ""
    compared: tuple[str, ...] = ()
    energy: bool = False


WEAVE = {"thetaR_dot": -13.0}  # 3.9 m/s, below the weave speed of 4.29 m/s: a bounded weave
TIP = ("x_tip", "y_tip", "z_tip")
SHORT = (
    Case(
        "bicycle/multipliers",
        20.0,
        truth="bicycle/independent",
        compared=("phi", "delta", "psi", "xP", "yP"),
        energy=True,
    ),
    Case(
        "double_pendulum/multipliers",
        10.0,
        truth="double_pendulum/quaternion",
        compared=TIP,
        energy=True,
    ),
    Case("bar_on_frame/two_body", 10.0, truth="bar_on_frame/reduced", compared=("theta", "tk_G_F")),
    Case("crank_shaft/multipliers", 4.0, truth="crank_shaft/driven", compared=("phi", "fx_A")),
)
LONG = (
    Case("bicycle/multipliers", 200.0, 0.1, WEAVE, energy=True),
    Case("double_pendulum/multipliers", 600.0, 0.1, energy=True),
    Case("bar_on_frame/two_body", 200.0, 0.1),
    Case("crank_shaft/multipliers", 60.0, 0.1),
)
CONTROLS = (
    ("none", "none", None),
    ("Baumgarte, 1/s", "baumgarte", 1.0),
    ("Baumgarte, 10/s", "baumgarte", 10.0),
    ("projection", "projection", None),
)


def main() -> None:
    if "--figure" in sys.argv:
        with matplotlib.rc_context(STYLE):
            save([_figure()], sys.argv[sys.argv.index("--figure") + 1])
        return
    for cases, tolerances in ((SHORT, (1e-6, 1e-8)), (LONG, (1e-8,))):
        print(
            "| model | solver | rtol | control | position | velocity | energy | error | calls "
            "| time |"
        )
        print("|---|---|---|---|---|---|---|---|---|---|")
        for case in cases:
            dae = cosim.load(case.model)
            truth = _truth(case)
            for solver in ("dop853", "idas"):
                for rtol in tolerances:
                    _measure(case, dae, truth, solver, rtol)
        print()


def _figure() -> Figure:
    """Draw the largest residual of bicycle and pendulum over a long run, up to each time."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, case in zip(axes, LONG[:2], strict=True):
        dae = cosim.load(case.model)
        for solver, style in (("idas", "--"), ("dop853", "-")):
            for (name, *control), color, marker in zip(CONTROLS, CURVES, "osD^", strict=False):
                if solver == "idas" and name == "projection":
                    continue
                run = _run(case, dae, solver, 1e-8, *control)
                drift = np.maximum.accumulate(np.maximum(*(run[m] for m in MONITORS)))
                look = {"color": color, "marker": marker, "markevery": 0.1, "markersize": 4}
                axis.plot(run.time, drift, style, label=f"{name} ({solver})", **look)
        axis.set(title=case.model, xlabel="time [s]", yscale="log", ylim=(1e-16, 1e-3))
        axis.margins(x=0)
    axes[0].set_ylabel("largest drift so far [m, m/s or 1]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _measure(case: Case, dae: Dae, truth: Trajectory | None, solver: str, rtol: float) -> None:
    """Print a row for each drift control that model and solver support."""
    possible = {
        name: control
        for name, *control in CONTROLS
        if (solver == "dop853" or name != "projection")
        and (dae.closing is not None or "Baum" not in name)
    }
    runs = {name: _run(case, dae, solver, rtol, *control) for name, control in possible.items()}
    times: dict[str, list[float]] = {name: [] for name in possible}
    slow = max(run.stats["solve_time"] for run in runs.values()) > SLOW
    for _ in range(2 if slow else REPEATS):
        for name, control in possible.items():
            again = _run(case, dae, solver, rtol, *control)
            times[name].append(again.stats["solve_time"])
    for name, run in runs.items():
        ratio = median(times[name]) / median(times["none"])
        drifts = " | ".join(f"{np.abs(run[monitor]).max():.0e}" for monitor in MONITORS)
        energy = f"{np.ptp(run['energy']) / np.abs(run['energy'][0]):.0e}" if case.energy else ""
        error = "" if truth is None else f"{_error(case, run, truth):.0e}"
        print(
            f"| {case.model} | {solver} | {rtol:.0e} | {name} | {drifts} | {energy} | {error} "
            f"| {run.stats['rhs_calls']} | {ratio:.2f} |",
            flush=True,
        )


def _run(
    case: Case, dae: Dae, solver: str, rtol: float, control: str, rate: float | None
) -> Trajectory:
    return cosim.simulate(
        dae if rate is None else _with_rate(dae, rate),
        solver=solver,
        relative_tolerance=rtol,
        stop_time=case.stop_time,
        output_interval=case.output_interval,
        outputs=(*case.compared, "energy", *MONITORS),
        drift_control=control,
        start_values=case.values,
        on_invalid="ignore",
    )


@cache
def _with_rate(dae: Dae, rate: float) -> Dae:
    """Return the model with a Baumgarte stabilization rate; the same object for the same rate."""
    return dae.closing_at(rate)


def _truth(case: Case) -> Trajectory | None:
    if not case.compared:
        return None
    return cosim.simulate(
        cosim.load(case.truth),
        solver="dop853",
        relative_tolerance=1e-13,
        stop_time=case.stop_time,
        outputs=case.compared,
        start_values=case.values,
    )


def _error(case: Case, run: Trajectory, truth: Trajectory) -> float:
    """Return the largest error in nominal values."""
    return cosim.compare(truth, run.select(case.compared)).worst.scaled


if __name__ == "__main__":
    sys.exit(main())
