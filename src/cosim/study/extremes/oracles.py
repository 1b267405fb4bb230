"""Errors of extreme cases, measured against closed forms, invariants and independent runs."""

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from math import isfinite
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from casadi_models.extreme_cases import Case, Counterpart
from cosim.arrays import Vector
from cosim.errors import CosimError, InitialConditionError, SolverError, UnknownName, UsageError
from cosim.integrate.keywords import requested
from cosim.integrate.run import run as execute
from cosim.integrate.solvers import SOLVERS
from cosim.model.catalogue import loaded
from cosim.trajectory import Trajectory

OUTCOMES = ("accurate", "refused", "failed", "silent", "unverified", "hang", "crash")


class CaseFinding(NamedTuple):
    """A case and its outcome.

    Attributes:
        case: The case.
        outcome: One of `OUTCOMES`.
        error: Measured relative error (1); None if the run has no result.
        reason: Why it was refused or failed, or what the run reports of its validity.
        seconds: Elapsed time, including the measurement of the error, s.
    """

    case: Case
    outcome: str
    error: float | None
    reason: str
    seconds: float

    def row(self) -> dict[str, Any]:
        """Return the finding as a row of a table, for CSV and JSON too."""
        return {
            "family": self.case.family,
            "model": self.case.model,
            "case": self.case.name,
            "outcome": self.outcome,
            "error": self.error if self.error is None or isfinite(self.error) else None,
            "bound": self.case.bound,
            "seconds": round(self.seconds, 3),
            "reason": self.reason,
        }


def run_case(case: Case) -> Trajectory:
    """Run a case with `simulate`."""
    return _run(case, case.stop_time, case.points, case.values, step_size=case.step_size)


def _run(
    how: Case | Counterpart, stop_time: float, points: int, values: Mapping[str, float], **more: Any
) -> Trajectory:
    fixed_steps = how.solver is not None and not SOLVERS[how.solver].adaptive
    request = requested(
        loaded(how.model),
        stop_time=stop_time,
        output_interval=stop_time / points,
        solver=how.solver,
        relative_tolerance=None if fixed_steps else how.relative_tolerance,
        start_values=values,
        **more,
    )
    return execute(request)


Runner = Callable[[Case], Trajectory]


def assess(case: Case, runner: Runner = run_case) -> CaseFinding:
    """Run a case, measure its error, and return its outcome."""
    began = perf_counter()
    try:
        outcome, error, reason = _assess(case, runner)
    except Exception as defect:  # an error that is none of `CosimError` counts as a crash
        outcome, error, reason = "crash", None, f"{type(defect).__name__}: {defect}"
    return CaseFinding(case, outcome, error, reason, perf_counter() - began)


def _assess(case: Case, runner: Runner) -> tuple[str, float | None, str]:
    try:
        run = runner(case)
    except (UsageError, UnknownName, InitialConditionError) as refusal:
        return "refused", None, str(refusal)
    except SolverError as failure:
        return "failed", None, str(failure)
    warned = "; ".join(run.stats.get("invalid", ()))
    try:
        error = ORACLES[case.oracle](case, run)
    except CosimError as failure:  # no reference; the run may have reported itself as invalid
        return ("failed" if warned else "unverified"), None, warned or str(failure)
    if error <= case.bound:
        return "accurate", error, warned
    return ("failed" if warned else "silent"), error, warned


def _crank(case: Case, run: Trajectory) -> float:
    """Closed form at constant acceleration; bearing loads by Unit 7, Example 1."""
    dae = loaded(case.model)
    given = {v.name: v.start or 0.0 for v in (*dae.parameters, *dae.states)} | dict(case.values)
    length, alpha, start = given["segment_length"], given["alpha"], given["omega"]
    mass = given["density"] * np.pi / 4 * given["diameter"] ** 2 * length  # of a segment
    omega = start + alpha * run.time
    exact = {
        "phi": start * run.time + alpha * run.time**2 / 2,
        "omega": omega,
        "fx_A": -mass * length * omega**2 / 2,
        "fx_B": mass * length * omega**2 / 2,
        "fy_A": mass * length * alpha / 2 + 0 * omega,
        "T": 10 / 3 * mass * length**2 * alpha + 0 * omega,
    }
    force = mass * length * (omega**2 + abs(alpha)).max()
    floors = {"phi": 1.0, "T": force * length}
    return _largest(
        _relative(run[name], value, floors.get(name, force if name[0] == "f" else 0.0))
        for name, value in exact.items()
    )


def _energy(_: Case, run: Trajectory) -> float:
    return _relative(run["energy"], run["energy"][0], float(run["kinetic_energy"].max()))


def _bicycle(case: Case, run: Trajectory) -> float:
    """Drift of the free bicycle: energy (1), gap of the front wheel (m), its slip (m/s)."""
    drifts = (np.abs(run[name]).max() for name in ("loop_closure", "slip_1", "slip_2", "slip_3"))
    return _largest((_energy(case, run), *drifts))


def _jacobi(_: Case, run: Trajectory) -> float:
    """Drift of Jacobi's integral of the undamped bar in a frame of constant rate."""
    integral = run["theta_dot"] ** 2 + (run["Omega"] * np.sin(run["theta"])) ** 2
    return _relative(integral, integral[0], 0.0)


def _power(case: Case, run: Trajectory) -> float:
    """Energy minus the work of the drive, without dampers; Simpson's rule over two intervals."""
    rate = 2 * np.pi
    power = rate * run["M_disk"]
    step = case.stop_time / case.points
    pairs = step / 3 * (power[:-2:2] + 4 * power[1:-1:2] + power[2::2])
    missing = run["energy"][2::2] - run["energy"][0] - np.cumsum(pairs)
    return float(np.abs(missing).max() / np.abs(run["kinetic_energy"]).max())


def _against_reference(case: Case, run: Trajectory) -> float:
    """Largest relative difference from the reference, over the variables of both runs."""
    values = tuple(sorted(case.values.items()))
    true = _reference(case.references, case.stop_time, case.points, values)
    if isinstance(true, str):
        raise SolverError(f"no reference: {true}")
    own = {name for model in (run.model, true.model) for name in loaded(model).own_meanings}
    names = [name for name in run.names if name in true.names and name not in own]
    return _largest(_relative(run[n], true[n], run.column(n).nominal) for n in names)


@lru_cache(maxsize=16)  # cases of several solvers share a reference
def _reference(
    references: tuple[Counterpart, ...],
    stop_time: float,
    points: int,
    values: tuple[tuple[str, float], ...],
) -> Trajectory | str:
    """Return the first reference that succeeds, or the reason of the last failure."""
    reason = "the case names no reference"
    for other in references:
        try:
            return _run(other, stop_time, points, dict(values), on_invalid="ignore")
        except SolverError as failure:
            reason = str(failure)
    return reason


ORACLES: dict[str, Callable[[Case, Trajectory], float]] = {
    "at_rest": lambda case, run: float(np.abs(run["theta"] - case.values["theta"]).max()),
    "bicycle": _bicycle,
    "crank": _crank,
    "energy": _energy,
    "jacobi": _jacobi,
    "power": _power,
    "reference": _against_reference,
    "upright": lambda _, run: _largest(abs(run[n]).max() for n in ("phi", "delta", "psi", "yP")),
}


def _largest(errors: Iterable[float]) -> float:
    """Return the largest error; not a number if one of them is none, unlike `max`."""
    return float(np.max([*errors]))


def _relative(value: Vector, true: Any, floor: float) -> float:
    size = max(float(np.abs(true).max()), floor)
    gap = float(np.abs(value - true).max())
    return gap / size if gap else 0.0
