"""`sensitivity`: derivatives of a run with their error under control, and a second opinion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.compiler import has_compiler
from cosim.errors import SolverError, UnknownName, UsageError
from cosim.integrate.ensemble.ensemble import Ensemble
from cosim.integrate.ensemble.simulate_many import simulate_many
from cosim.integrate.run.pieces import input_values
from cosim.integrate.simulate import simulate
from cosim.memo import kept_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.reduction.reduce import reduce
from cosim.model.values import assign, checked, listed, number, plain_values
from cosim.study.sensitivity.differences import differences
from cosim.study.sensitivity.result import Agreement, Sensitivity
from cosim.study.sensitivity.variational import (
    SensitivityTarget,
    derivative,
    direction,
    start_slopes,
    variational,
)
from cosim.trajectory import Column, Trajectory

DERIVATIVE_TOLERANCE = 1e-8
AGREEMENT_BOUND = 1e-5  # of two methods, scaled
CHECK_TOLERANCE = 1e-12  # of the runs whose differences are taken


def sensitivity(
    dae: Dae,
    *,
    of: Sequence[str] | None = None,
    with_respect_to: Sequence[str] | None = None,
    start_values: Mapping[str, float] | None = None,
    inputs: InputSeries | None = None,
    solver: str | None = None,
    relative_tolerance: float = DERIVATIVE_TOLERANCE,
    check: bool = True,
    bound: float = AGREEMENT_BOUND,
    **times: Any,
) -> Sensitivity:
    """Differentiate a run: d(output)/d(parameter, start value, constant input) over time.

    The variational equations are integrated with the model, their error under the same control as
    its own (forward mode). Differences of runs at 1e-12 then check every derivative of this run.

    Args:
        dae: The model.
        of: Names of states, algebraic unknowns or outputs; the states when None.
        with_respect_to: Names of parameters, constant inputs, or states, by whose start value is
            differentiated; all parameters when None. Start values that are calculated follow.
        start_values: Values by name that replace starts of states, parameters, or inputs.
        inputs: Time series of some inputs.
        solver: An adaptive one; dop853, or without a compiler erk or rosenbrock, when None.
        relative_tolerance: Error per step, of the derivatives, too.
        check: Whether a second method checks the result.
        bound: Largest scaled difference of both methods that is agreement; see `Agreement`.
        times: `start_time`, `stop_time`, `output_interval`, s; see `simulate`.

    Returns:
        Derivatives of shape (times, outputs, targets), in SI units.

    Raises:
        UnknownName: A name does not exist.
        UsageError: An input follows a series; or there is nothing to differentiate (by).
        InitialConditionError: A start value is calculated: it follows from others.
        SolverError: A run failed, or the second method disagrees.

    Example:
        >>> import cosim
        >>> found = sensitivity(cosim.load("crank_shaft"), with_respect_to=["alpha"], stop_time=1)
        >>> float(found["phi", "alpha"][-1].round(6))  # of t^2 / 2
        0.5
    """
    number("sensitivity", "bound", bound, positive=True)
    start_values = plain_values(dae, start_values or {})
    values = assign(dae, start_values)
    names = [v.name for v in dae.states] if of is None else listed("sensitivity: of", of)
    by = [v.name for v in dae.parameters]
    if with_respect_to is not None:
        by = [*listed("sensitivity: with_respect_to", with_respect_to)]
    whole = [_target(dae, name, inputs) for name in by]
    small = _reduced(dae, tuple(names))
    numbers = {"state": values.x, "parameter": values.p, "input": values.u}
    at = [float(numbers[target.kind][target.row]) for target in whole]
    fallback = "rosenbrock" if dae.algebraics else "erk"
    solver = solver or ("dop853" if has_compiler() else fallback)
    known = {v.name for v in (*small.states, *small.parameters, *small.inputs)}
    felt = inputs and inputs.only({v.name for v in small.inputs})
    task = _Task(
        small,
        names,
        {name: value for name, value in start_values.items() if name in known},
        {"solver": solver, "inputs": felt, **times},
    )
    targets = [own for name in by if (own := SensitivityTarget.of(small, name)) is not None]
    plain, found = task.forward(targets, relative_tolerance)
    columns = tuple(
        Column(t.variable.name, t.variable.unit, None, t.size, t.variable.meaning) for t in whole
    )
    rows = [by.index(target.variable.name) for target in targets]  # the others have no influence
    table, second = np.zeros((2, len(plain), len(names), len(by)))
    table[:, :, rows] = found
    result = Sensitivity(plain, columns, table)
    if not check or not targets:
        return result
    second[:, :, rows] = differences(task.changed, targets, [at[row] for row in rows])
    agreement = _agreement(result, second, f"differences of {solver} at {CHECK_TOLERANCE:g}", bound)
    if not agreement.scaled <= bound:
        raise SolverError(
            f"{dae.full_name}: the derivatives are not confirmed: d {agreement.of} / d "
            f"{agreement.with_respect_to} at {agreement.time:g} s is {agreement.first:.9g} by "
            f"{solver} at {relative_tolerance:g}, {agreement.second:.9g} by {agreement.method}, "
            f"{agreement.scaled:.1e} apart (bound {bound:g}); tighten relative_tolerance, or ask "
            "for a shorter run",
            plain,
        )
    return Sensitivity(plain, columns, table, agreement)


@kept_per_thread(8)
def _reduced(dae: Dae, names: tuple[str, ...]) -> Dae:
    return reduce(dae, names)


def _target(dae: Dae, name: str, inputs: InputSeries | None) -> SensitivityTarget:
    """Return what is differentiated by.

    Raises:
        UnknownName, InitialConditionError, UsageError: It cannot be.
    """
    found = SensitivityTarget.of(dae, name)
    if found is None:
        known = [v.name for v in (*dae.parameters, *dae.states, *dae.inputs)]
        raise UnknownName.of_model(dae.full_name, "parameter, state or input", name, known)
    checked(dae, found.variable, found.variable.start)
    if inputs is not None and name in inputs.names:
        raise UsageError(
            f"{dae.full_name}: {name} follows a series; give it a constant value, or leave it out "
            "of with_respect_to"
        )
    return found


@dataclass(frozen=True)
class _Task:
    """What is run: a model, the names that are recorded, what is set, and how it is solved."""

    dae: Dae
    names: Sequence[str]
    start: Mapping[str, float]
    options: Mapping[str, Any]

    def forward(
        self, targets: Sequence[SensitivityTarget], tolerance: float
    ) -> tuple[Trajectory, Vector]:
        """Return the outputs and their derivatives, (n, ny, targets)."""
        if not targets:
            options = {**self.options, "relative_tolerance": tolerance}
            run = simulate(self.dae, start_values=self.start, outputs=self.names, **options)
            return run, np.zeros((len(run), len(self.names), 0))
        begin = number(self.dae.full_name, "start_time", self.options.get("start_time", 0.0))
        values = assign(self.dae, self.start)
        u = input_values(self.dae, np.array([begin]), values, self.options["inputs"])[:, 0]
        slopes = start_slopes(self.dae, begin, replace(values, u=u), targets)
        given: dict[str, Any] = dict(self.start)
        for state, row in zip(self.dae.states, slopes, strict=True):
            given[derivative(state.name)] = row
        for j, target in enumerate(targets):
            if target.kind != "state":
                row = np.zeros(len(targets))
                row[j] = target.size
                given[direction(target.variable.name)] = row
        wanted = [*self.names, *map(derivative, self.names)]
        found = self.runs(variational(self.dae), given, wanted, tolerance)
        plain = found.run(0).select(self.names)
        calls = {"steps": int(found.steps.sum()), "rhs_calls": int(found.rhs_calls.sum())}
        stats = {**found.stats, **calls}  # of all directions together
        values = found.values[:, :, len(self.names) :] / np.array([[[t.size]] for t in targets])
        return replace(plain, stats=stats), np.moveaxis(values, 0, -1)

    def changed(self, changes: Sequence[tuple[str, float]]) -> Vector:
        """Return the outputs with one value replaced at a time, (changes, n, ny)."""
        base = {**{name: self.number(name) for name, _ in changes}, **self.start}
        given = {name: np.full(len(changes), value) for name, value in base.items()}
        for i, (name, value) in enumerate(changes):
            given[name][i] = value
        return self.runs(self.dae, given, self.names, CHECK_TOLERANCE).values

    def number(self, name: str) -> float:
        """Return the model's own value of a parameter, an input or a start."""
        return float(self.dae.variable(name).start or 0.0)

    def runs(
        self, dae: Dae, given: Mapping[str, Any], names: Sequence[str], tolerance: float
    ) -> Ensemble:
        options = {**self.options, "relative_tolerance": tolerance, "on_invalid": "ignore"}
        found = simulate_many(dae, given, outputs=names, **options)
        if not found.complete.all():
            first = min(found.reasons)
            raise SolverError(
                f"{self.dae.full_name}: a run at {tolerance:g} failed: {found.reasons[first]}; use "
                "another solver, another tolerance or a shorter run"
            )
        return found


def _agreement(result: Sensitivity, second: Vector, method: str, bound: float) -> Agreement:
    """Return where two methods are farthest apart."""
    sizes = np.array([target.nominal for target in result.targets])
    nominal = np.array([column.nominal for column in result.run.columns])
    largest = np.abs(second).max(axis=0) * sizes + nominal[:, None]
    apart = np.abs(result.values - second) * sizes / largest
    apart = np.where(np.isnan(apart), np.inf, apart)
    row, i, j = (int(k) for k in np.unravel_index(int(apart.argmax()), apart.shape))
    return Agreement(
        method,
        float(apart[row, i, j]),
        result.run.names[i],
        result.targets[j].name,
        float(result.run.time[row]),
        float(result.values[row, i, j]),
        float(second[row, i, j]),
        bound,
    )
