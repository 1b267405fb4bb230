"""`sensitivity`: derivatives of a run, checked by finite differences of runs.

The derivatives follow from the variational equations, see `casadi_models.dae.variational`. A solver
of the whole system controls their errors in the same way as those of x. The direction is a
parameter, so that one compiled model serves every derivative, and many directions can be integrated
at once.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Unpack

import casadi as ca
import numpy as np

from casadi_models.dae import Dae, Variable
from casadi_models.dae.starts import StartThrough
from casadi_models.dae.variational import derivative, direction, variational
from cosim.arrays import Truths, Vector
from cosim.codegen.compiler import has_compiler
from cosim.codegen.functions import symbols_like
from cosim.codegen.initialization import start_function
from cosim.errors import InitialConditionError, SolverError, UnknownName, UsageError
from cosim.integrate.ensemble.ensemble import Ensemble
from cosim.integrate.ensemble.simulate_many import simulate_many
from cosim.integrate.initial_values import input_values
from cosim.integrate.initial_values import start_values as start_values_at
from cosim.integrate.keywords import TimeKeywords, requested
from cosim.integrate.run import run
from cosim.integrate.solvers import requested_solver, solver_named
from cosim.memo import cached_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.reduction import reduce
from cosim.model.request import OnInvalid, RunRequest
from cosim.model.times import one_time
from cosim.model.values import Values, assign, checked, listed, number, plain_values
from cosim.series.samples import below
from cosim.study.sensitivity.result import Agreement, Sensitivity
from cosim.text import MOST_NAMES, one_note
from cosim.trajectory import Column, Trajectory

_SAME = 1e-6  # relative difference up to which an event changes nothing
_variational = cached_per_thread(8)(variational)
_reduced = cached_per_thread(8)(reduce)


@dataclass(frozen=True)
class SensitivityTarget:
    """A parameter, a constant input or an initial value by which a run is differentiated.

    Attributes:
        variable: The variable of the model.
        kind: "parameter", "input" or "state".
        row: Its index among the variables of its kind.
        size: Magnitude of its own value or, if that is zero, its nominal value.
    """

    variable: Variable
    kind: str
    row: int
    size: float

    @classmethod
    def of(cls, dae: Dae, name: str) -> "SensitivityTarget | None":
        """Return the target of that name; None if the DAE has no such variable."""
        kinds = {"parameter": dae.parameters, "input": dae.inputs, "state": dae.states}
        for kind, variables in kinds.items():
            for row, variable in enumerate(variables):
                if variable.name == name:
                    return cls(variable, kind, row, abs(variable.start or 0.0) or variable.nominal)
        return None


def start_slopes(
    dae: Dae, t: float, values: Values, targets: Sequence[SensitivityTarget]
) -> Vector:
    """Return the derivatives of the initial values of all states at time t, s, (nx, k).

    Calculated initial values are included.
    """
    blocks = _start_jacobians(dae)(t, values.x, values.u, values.p)
    columns = dict(zip(("state", "input", "parameter"), map(np.array, blocks), strict=True))
    return np.column_stack([columns[target.kind][:, target.row] for target in targets])


@cached_per_thread(8)
def _start_jacobians(dae: Dae) -> ca.Function:
    t, x, _, u, p = symbols_like(dae)
    start, _ = start_function(dae)(t, x, u, p)
    blocks = [ca.densify(ca.jacobian(start, symbol)) for symbol in (x, u, p)]
    return ca.Function("start_jacobians", [t, x, u, p], blocks)


STEPS = 1e-4 / 16.0 ** np.arange(4)  # of finite differences, relative to the size of the target
# Derivative = sum of weight * run(value + shift * step) / step; both formulas are of fourth order
CENTRAL = {1: 2 / 3, -1: -2 / 3, 2: -1 / 12, -2: 1 / 12}
ONE_SIDED = {0: -25 / 12, 1: 4.0, 2: -3.0, 3: 4 / 3, 4: -1 / 4}

Runs = Callable[[Sequence[tuple[str, float]]], Vector]


def differences(
    runs: Runs, targets: Sequence[SensitivityTarget], at: Sequence[float], share: float
) -> Vector:
    """Return finite differences of fourth order, (n, ny, targets).

    Args:
        runs: Function that runs the model once for each changed value: outputs (changes, n, ny).
        targets: Parameters, initial values and inputs by which the outputs are differentiated.
        at: Their values in this run, SI.
        share: Of the size of a target: the step.
    """
    changes: list[tuple[str, float]] = []
    rules = []
    for target, value in zip(targets, at, strict=True):
        step, weights = share * target.size, CENTRAL
        up, down = target.variable.maximum - value, value - target.variable.minimum
        if min(up, down) < 2 * step:  # the steps stay within the bounds, and their rounding
            step, weights = min(step, max(up, down) / 5), ONE_SIDED
            step = step if up >= down else -step
        rules.append((step, [*weights.values()]))
        changes += [(target.variable.name, value + shift * step) for shift in weights]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the run itself has warned already
        moved = iter(runs(changes))
    columns = [sum(w * next(moved) for w in weights) / step for step, weights in rules]
    return np.stack(columns, axis=-1)


DERIVATIVE_TOLERANCE = 1e-8
AGREEMENT_BOUND = 1e-5  # largest scaled difference of two methods
CHECK_TOLERANCE = 1e-12  # of the runs for finite differences


def sensitivity(
    dae: Dae | str,
    *,
    outputs: Sequence[str] | None = None,
    with_respect_to: Sequence[str] | None = None,
    start_values: Mapping[str, float] | None = None,
    inputs: InputSeries | None = None,
    solver: str | None = None,
    relative_tolerance: float = DERIVATIVE_TOLERANCE,
    check: bool = True,
    bound: float = AGREEMENT_BOUND,
    **times: Unpack[TimeKeywords],
) -> Sensitivity:
    """Differentiate a run: d(output)/d(parameter, start value, constant input) over time.

    The variational equations are integrated together with the model, under the same error control
    (forward mode). Finite differences of runs at 1e-12 then check every derivative.

    Args:
        dae: The model, or its name.
        outputs: Names of states, algebraic unknowns or outputs; all states when None.
        with_respect_to: Names of parameters, constant inputs or states; a state stands for its
            initial value, and so does an output that may be given instead of one, such as the
            bicycle's `speed`. All parameters when None. Calculated initial values depend on them.
        start_values: Values by name that replace initial values, parameters or inputs, SI.
        inputs: Time series of some inputs.
        solver: Name of an adaptive solver; when None dop853, or without a compiler erk (with
            algebraic unknowns rosenbrock).
        relative_tolerance: Error per step of the run and of the derivatives (1).
        check: Whether finite differences check the result.
        bound: Largest scaled difference that counts as agreement (1); see `Agreement`.
        times: `start_time`, `stop_time`, `output_interval`, `output_times`, s; see `simulate`.

    Returns:
        Derivatives of shape (times, outputs, targets), in SI units.

    Raises:
        UnknownName: A name does not exist.
        UsageError: An input of `with_respect_to` follows a time series; or the solver has no error
            control.
        InitialConditionError: An initial value of `with_respect_to` is calculated from others.
        SolverError: A run failed, or the finite differences disagree.

    Example:
        >>> import cosim
        >>> found = sensitivity(cosim.load("crank_shaft"), with_respect_to=["alpha"], stop_time=1)
        >>> float(found["phi", "alpha"][-1].round(6))  # of t^2 / 2
        0.5
    """
    number("sensitivity", "bound", bound, positive=True)
    dae = requested(dae).dae
    start_values = plain_values(dae, start_values or {})
    values = assign(dae, start_values)
    names = [v.name for v in dae.states]
    if outputs is not None:
        names = [*listed("sensitivity: outputs", outputs)]
    chosen = [v.name for v in dae.parameters]
    if with_respect_to is not None:
        chosen = [*dict.fromkeys(listed("sensitivity: with_respect_to", with_respect_to))]
    ways = {way.variable.name: way for way in dae.start_outputs if way.variable.name in chosen}
    by = [*dict.fromkeys(_state_of(dae, ways, name) for name in chosen)]
    whole = [_target(dae, name, inputs) for name in by]
    small = _reduced(dae, tuple(names))
    numbers = {"state": values.x, "parameter": values.p, "input": values.u}
    at = [float(numbers[target.kind][target.row]) for target in whole]
    sizes = {t.variable.name: abs(v) or t.variable.nominal for t, v in zip(whole, at, strict=True)}
    fallback = "rosenbrock" if dae.algebraics else "erk"
    UsageError.reject("sensitivity: solver", solver, str | None, "the name of a solver")
    solver = solver or ("dop853" if has_compiler() else fallback)
    if not solver_named(dae, solver).adaptive:
        raise UsageError(f"sensitivity: {solver} has no error control; choose another solver")
    known = {v.name for v in (*small.states, *small.parameters, *small.inputs)}
    request = requested(
        small,
        start_values={name: value for name, value in start_values.items() if name in known},
        inputs=inputs and inputs.only({v.name for v in small.inputs}),
        outputs=names,
        **times,
    )
    task = _Task(request, solver, relative_tolerance)
    used = [own for name in by if (own := SensitivityTarget.of(small, name)) is not None]
    targets = [replace(target, size=sizes[target.variable.name]) for target in used]
    plain, found = task.forward(targets)
    columns = tuple(
        Column(name, t.variable.unit, None, sizes[name], t.variable.meaning)
        for name, t in zip(by, whole, strict=True)
    )
    rows = [by.index(target.variable.name) for target in targets]  # others have no influence
    table = np.zeros((len(plain), len(names), len(by)))
    table[:, :, rows] = found
    result = Sensitivity(plain, columns, table)
    if check and targets:
        agreement = task.agreement(result, targets, [at[row] for row in rows], bound)
        result = Sensitivity(plain, columns, table, agreement)
    return _through_outputs(dae, result, chosen, ways, values) if ways else result


def _state_of(dae: Dae, ways: Mapping[str, StartThrough], name: str) -> str:
    """Return the state whose initial value an output gives; other names as they are."""
    return dae.states[ways[name].state].name if name in ways else name


def _through_outputs(
    dae: Dae,
    found: Sensitivity,
    by: Sequence[str],
    ways: Mapping[str, StartThrough],
    values: Values,
) -> Sensitivity:
    """Return derivatives by outputs that give initial values, from those by their states."""
    begin = float(found.run.time[0])
    start, inner = start_values_at(dae, begin, values), [target.name for target in found.targets]
    columns, table = [], []
    for name in by:
        place = inner.index(_state_of(dae, ways, name))
        column, factor = found.targets[place], 1.0
        if name in ways:
            column, slope = _start_output(dae, ways[name], begin, start, values)
            if not slope:
                raise InitialConditionError(
                    f"{dae.full_name}: the start value of {inner[place]} does not change {name} "
                    f"here; differentiate with respect to {inner[place]}"
                )
            factor = 1 / slope
        columns.append(column)
        table.append(found.values[:, :, place] * factor)
    return replace(found, targets=tuple(columns), values=np.stack(table, axis=-1))


def _start_output(
    dae: Dae, way: StartThrough, begin: float, start: Vector, values: Values
) -> tuple[Column, float]:
    """Return an output that gives an initial value, and its derivative by that value."""
    name = dae.states[way.state].name
    target = SensitivityTarget.of(dae, name)
    assert target is not None
    law = ca.Function("law", [dae.x, dae.p], [way.expression, ca.jacobian(way.expression, dae.x)])
    value, slopes = (np.array(block) for block in law(start, values.p))
    slope = float((slopes @ start_slopes(dae, begin, values, [target])).item())
    v = way.variable
    size = abs(float(value.item())) or v.nominal
    return Column(v.name, v.unit, None, size, v.meaning), slope


def _target(dae: Dae, name: str, inputs: InputSeries | None) -> SensitivityTarget:
    """Return the target of a name; reject one by which a run cannot be differentiated."""
    found = SensitivityTarget.of(dae, name)
    if found is None:
        known = [v.name for v in (*dae.parameters, *dae.states, *dae.inputs)]
        raise UnknownName.of_model(dae.full_name, "parameter, state or input", name, known)
    checked(dae, found.variable, found.variable.start)
    if inputs is not None and name in inputs.names:
        raise UsageError(
            f"{dae.full_name}: {name} follows a time series; give it a constant value, or remove "
            "it from with_respect_to"
        )
    return found


@dataclass(frozen=True)
class _Task:
    """A request without a solver, its solver's name and relative tolerance.

    `events` are the times of the events of changed runs.
    """

    request: RunRequest
    solver: str
    tolerance: float
    events: list[Vector] = field(default_factory=list)

    def at(self, tolerance: float) -> RunRequest:
        """Return the request at a relative tolerance."""
        solver = requested_solver(self.request.dae, self.solver, tolerance)
        return replace(self.request, solver=solver)

    def forward(self, targets: Sequence[SensitivityTarget]) -> tuple[Trajectory, Vector]:
        """Return the outputs and their derivatives, (n, ny, targets)."""
        dae, names = self.request.dae, self.request.outputs or ()
        if not targets:
            found = run(self.at(self.tolerance))
            return found, np.zeros((len(found), len(names), 0))
        begin, values = self.request.times.start, self.request.numbers
        u = input_values(dae, np.array([begin]), values, self.request.inputs)[:, 0]
        sizes = np.array([max(t.size, t.variable.nominal) for t in targets])  # above tolerances
        slopes = start_slopes(dae, begin, replace(values, u=u), targets) * sizes
        rows: dict[str, Any] = dict(self.request.values)
        for state, row in zip(dae.states, slopes, strict=True):
            rows[derivative(state.name)] = row
        for j, target in enumerate(targets):
            if target.kind != "state":
                row = np.zeros(len(targets))
                row[j] = sizes[j]
                rows[direction(target.variable.name)] = row
        outputs = (*names, *map(derivative, names))
        with_slopes = replace(
            self.at(self.tolerance), dae=_variational(dae), outputs=outputs, values={}
        )
        many = self._runs(with_slopes, rows)
        n, plain = int(many.reached.min()), many.run(0).select(names)  # a stop may have ended it
        plain = replace(plain, time=plain.time[:n], values=plain.values[:n])
        calls = {"steps": int(many.steps.sum()), "rhs_calls": int(many.rhs_calls.sum())}
        values_of = many.values[:, :n, len(names) :] / sizes[:, None, None]
        return replace(plain, stats={**many.stats, **calls}), np.moveaxis(values_of, 0, -1)

    def between_events(self, times: Vector) -> Truths:
        """Return at which times all changed runs have passed equally many events, (n,)."""
        found = np.ones(len(times), dtype=bool)
        common = self._resting_events
        for events in self.events:
            passed = np.searchsorted(events, times)
            found &= passed == np.searchsorted(self.events[0], times)
            moved = np.setdiff1d(events, common)  # samples stay where they are
            found &= ~one_time(times[:, None], moved, self.request.times.start).any(axis=1)
        return found

    @property
    def _resting_events(self) -> Vector:
        """Times of events that no change moves, such as samples."""
        common = self.events[0] if self.events else np.empty(0)
        for events in self.events:
            common = np.intersect1d(common, events)
        return common

    def one_sided(self, plain: Trajectory) -> str:
        """Return a note on the times at which events that move change what is differentiated."""
        found = dict[float, str]()
        for event in plain.events:
            at = plain.time[one_time(plain.time, event.time, self.request.times.start)]
            before, after = ([*side.values()] for side in (event.before, event.after))
            jumps = not np.allclose(before, after, rtol=_SAME, atol=0, equal_nan=True)
            if len(at) and jumps and event.time not in self._resting_events:
                found.setdefault(float(at[-1]), event.name)
        if not found:
            return ""
        shown = [f"{time:g} s ({name})" for time, name in found.items()][:MOST_NAMES]
        return f"derivatives are one-sided, those after an event, at {', '.join(shown)}"

    def changed(self, changes: Sequence[tuple[str, float]]) -> Vector:
        """Return the outputs with one value replaced at a time, (changes, n, ny)."""
        request = self.at(CHECK_TOLERANCE)
        own = {name: float(request.dae.variable(name).start or 0.0) for name, _ in changes}
        base = {**own, **request.values}
        given = {name: np.full(len(changes), value) for name, value in base.items()}
        for i, (name, value) in enumerate(changes):
            given[name][i] = value
        many = self._runs(replace(request, values={}), given)
        runs = (many.run(i) for i in range(len(changes)))
        self.events.extend(np.array([event.time for event in run.events]) for run in runs)
        return many.values[:, : many.reached.min()]

    def agreement(
        self,
        result: Sensitivity,
        targets: Sequence[SensitivityTarget],
        at: Sequence[float],
        bound: float,
    ) -> Agreement:
        """Return how well finite differences agree with a result.

        Args:
            result: The derivatives; they are 0 with respect to all but `targets`.
            targets, at: What the outputs depend on, and its values in this run, SI.
            bound: Largest scaled difference that counts as agreement (1).

        Raises:
            SolverError: They disagree, or can be compared at less than half of the times.
        """
        plain, model = result.run, self.request.dae.full_name
        second, compared = self._differences(result, targets, at, bound)
        if 2 * compared.sum() < len(compared):
            raise SolverError(
                f"{model}: finite differences check the derivatives at {compared.sum()} of "
                f"{len(compared)} times only, as a small change of a value leads to other events; "
                "shorten the run, or leave the check out (check=False)",
                plain,
            )
        method = f"finite differences of {self.solver} at {CHECK_TOLERANCE:g}"
        agreement = _agreement(result, second, method, bound, compared)
        agreement = replace(agreement, note=one_note(agreement.note, self.one_sided(plain)))
        if not agreement.scaled <= bound:
            raise SolverError(
                f"{model}: two methods disagree on a derivative: d {agreement.output} / d "
                f"{agreement.with_respect_to} at {agreement.time:g} s is {agreement.first:.9g} by "
                f"{self.solver} at {self.tolerance:g}, {agreement.second:.9g} by {method}; the "
                f"scaled difference is {agreement.scaled:.1e} (bound {bound:g}); tighten "
                "relative_tolerance, or shorten the run",
                plain,
            )
        return agreement

    def _differences(
        self,
        result: Sensitivity,
        targets: Sequence[SensitivityTarget],
        at: Sequence[float],
        bound: float,
    ) -> tuple[Vector, Truths]:
        """Return finite differences, and at which times they tell; see `agreement`.

        A step is right if it is small beside what a value changes, such as the place of a narrow
        bump, and large beside rounding: it gets finer for the targets that do not agree.
        """
        names = [column.name for column in result.targets]
        second = np.zeros(result.values.shape)
        best = np.full(len(names), np.inf)
        numbers = dict(zip(targets, at, strict=True))
        n = len(result.run)
        for share in STEPS:
            moved = differences(self.changed, [*numbers], [*numbers.values()], share)[:n]
            n = len(moved)
            tried = second.copy()
            tried[:n, :, [names.index(target.variable.name) for target in numbers]] = moved
            compared = self.between_events(result.run.time) & (np.arange(len(result.run)) < n)
            apart = _apart(result, tried, compared).max(axis=(0, 1))
            second[:, :, apart <= best] = tried[:, :, apart <= best]
            best = np.fmin(apart, best)
            near = [names[i] for i in np.flatnonzero(best <= bound)]
            numbers = {t: value for t, value in numbers.items() if t.variable.name not in near}
            if not numbers:
                break
        return second, compared

    def _runs(self, request: RunRequest, given: Mapping[str, Any]) -> Ensemble:
        found = simulate_many(request, given, on_invalid=OnInvalid.IGNORE)
        if not found.complete.all():
            first = min(found.reasons)
            raise SolverError(
                f"{request.dae.full_name}: a run with {found.stats['solver']} at "
                f"{found.stats['relative_tolerance']:g} failed: {found.reasons[first]}; use "
                "another solver, another tolerance or a shorter run"
            )
        return found


def _apart(result: Sensitivity, second: Vector, rows: Truths) -> Vector:
    """Return the scaled differences between two methods, 0 at other times; see `Agreement`."""
    sizes = np.array([target.nominal for target in result.targets])
    nominal = np.array([column.nominal for column in result.run.columns])
    largest = np.abs(second).max(axis=0) * sizes + nominal[:, None]
    apart = np.abs(result.values - second) * sizes / largest
    apart = np.where(np.isnan(apart), np.inf, apart)
    apart[~rows] = 0.0
    return np.asarray(apart)


def _agreement(
    result: Sensitivity, second: Vector, method: str, bound: float, rows: Truths
) -> Agreement:
    """Return the largest scaled difference between two methods at some of the times."""
    apart = _apart(result, second, rows)
    sizes = np.array([target.nominal for target in result.targets])
    weights = np.abs(result.values * sizes).max(axis=2)
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
        below(result.run.columns, weights, bound, "the bound is more than all derivatives"),
    )
