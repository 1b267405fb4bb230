"""`fit`: parameters and initial values from measurements, by nonlinear least squares."""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, TypedDict, Unpack

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Integers, Truths, Vector
from cosim.errors import InitialConditionError, ParameterError, SolverError, UnknownName, UsageError
from cosim.host.optional_packages import optional_module
from cosim.model.inputs import InputSeries
from cosim.model.values import MOST_SEED, number, whole
from cosim.study.fit.result import Fit
from cosim.study.fit.subject import Subject, subject_of
from cosim.study.fit.unknowns import Unknowns
from cosim.text import counted, with_unit
from cosim.trajectory import Trajectory

LOSSES = ("linear", "soft_l1", "huber", "cauchy", "arctan")
RANK = 1e-6  # singular values below this share of the largest identify nothing
SHARE = 0.1  # of a combination, from which a value is named in it
REWEIGHTINGS = 10  # most repetitions with noise estimated from the last residuals
SETTLED = 1e-3  # relative change of the estimated noise that ends them
FURTHER = 10  # most minimizations, each from where the one before points to
CONVERGED = 1e-3  # distance to the minimum in standard errors, after Bates and Watts (1981)
ROUNDED = 1e-6  # relative steps that are not looked at: runs have errors of their own
TOLERANCE = 1e-10  # of the minimization: of values, cost and gradient, all relative
NORMAL = 1.4826  # standard deviation of a normal distribution by its median deviation


class FitKeywords(TypedDict, total=False):
    """Settings of the runs; see `fit`."""

    inputs: Any
    solver: str
    relative_tolerance: float


def fit(
    model: Dae | str | os.PathLike[str],
    measured: Trajectory | Sequence[Trajectory],
    parameters: Mapping[str, Any] | Sequence[str],
    *,
    each: Sequence[str] = (),
    start_values: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
    loss: str = "linear",
    starts: int = 1,
    seed: int = 0,
    confidence: float = 0.95,
    **settings: Unpack[FitKeywords],
) -> Fit:
    """Fit parameters, start values and constant inputs to measurements.

    `scipy.optimize.least_squares` minimizes the sum of the squared residuals, each divided by the
    noise of its output. The Jacobian of a model is exact, events included; that of an FMU follows
    from finite differences of its runs.

    Args:
        model: A `Dae`, the name of a model, or the file of an FMU, which runs in this process.
        measured: One record or several, e.g. of `Trajectory.read_csv`; all their variables are
            outputs of the model. NaN are gaps. Each run begins at time 0.
        parameters: The unknowns by name: None for the model's own value and bounds, an initial
            value, the bounds (low, high), or (low, initial value, high); SI. A list of names stands
            for None.
        each: Unknowns that differ from record to record, such as start values; their names then are
            "x (record 1)" and so on.
        start_values: Further values by name, SI.
        noise: Standard deviations of the outputs by name, SI; estimated from the residuals of each
            output when None.
        loss: "linear", or for outliers "soft_l1", "huber", "cauchy" or "arctan".
        starts: Number of initial values: the model's own, and a Latin hypercube within the bounds.
        seed: Random seed of these.
        confidence: Probability that an interval contains the value (1).
        settings: `inputs` (time series), `solver`, `relative_tolerance` of the runs; see
            `simulate`.

    Returns:
        Values, standard errors, confidence intervals and correlation; what the measurements do not
        identify; the model, a scene and runs with the fitted values.

    Raises:
        MissingTool: scipy is not installed.
        UnknownName: A name does not exist.
        UsageError: Nothing is measured or unknown, or an output is in another unit.
        ParameterError: A number or bounds are wrong, or there are fewer measurements than unknowns.
        SolverError: The run with the initial values failed.

    Example:
        >>> import cosim
        >>> record = cosim.simulate("crank_shaft", stop_time=1, outputs=["phi"])
        >>> found = fit("crank_shaft", record, {"alpha": (1.0, 50.0), "omega": 40.0})
        >>> {name: round(value, 6) for name, value in found.values.items()}
        {'alpha': 10.0, 'omega': 50.0}
    """
    optimize, stats = (optional_module(f"scipy.{name}", "data") for name in ("optimize", "stats"))
    UnknownName.reject("fit", "loss", LOSSES, loss)
    confidence = number("fit", "confidence", confidence)
    if not 0 < confidence < 1:
        raise ParameterError(f"fit: confidence = {confidence} is not between 0 and 1")
    whole("fit", "starts", starts)
    whole("fit", "seed", seed, 0, MOST_SEED)
    expected = "what cosim.read_inputs returns"
    UsageError.reject("fit: inputs", settings.get("inputs"), InputSeries | None, expected)
    subject = subject_of(model, settings)
    fixed = dict(start_values or {})
    records = _records(subject, measured)
    unknowns = Unknowns.of(subject, parameters, fixed, each, len(records))
    problem = _Problem(subject, records, unknowns, fixed)
    if problem.samples <= len(unknowns.names):
        raise ParameterError(
            f"fit: {problem.samples} measured values cannot determine {len(unknowns.names)} "
            "unknowns; give more measurements, or fit fewer values"
        )
    problem.reject_overflow()
    sizes = problem.noise(noise)
    best, failed = None, 0
    for start in unknowns.starts(starts, seed):
        try:
            found = problem.solved(optimize.least_squares, start, sizes, loss, noise is None)
        except (SolverError, InitialConditionError):
            if starts == 1:
                raise
            failed += 1
            continue
        if best is None or found.cost < best.cost:
            best = found
    if best is None:
        raise SolverError(f"{subject.name}: the run failed with every one of {starts} starts")
    notes = [f"the run failed with {failed} of {starts} starts"] if failed else []
    freedom = problem.samples - int(best.free.sum())
    degrees = np.inf if noise is not None else freedom
    reach = float(stats.t.ppf((1 + confidence) / 2, degrees))
    return problem.result(best, confidence, reach, notes)


@dataclass(frozen=True, eq=False)
class _Solution:
    """The result of one minimization.

    Attributes:
        x: Scaled values.
        free: Which of them no bound stops.
        cost: What other minimizations are compared by.
        jacobian: Derivatives of the weighted residuals.
        noise: By output.
        missing: What is missing to the minimum; empty if nothing.
    """

    x: Vector
    free: Truths
    cost: float
    jacobian: Vector
    noise: Vector
    missing: str


@dataclass(frozen=True, eq=False)
class _Problem:
    """Residuals of records and their derivatives by unknowns that are scaled by their sizes."""

    subject: Subject
    records: tuple[Trajectory, ...]
    unknowns: Unknowns
    fixed: Mapping[str, float]
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        every = dict.fromkeys(name for record in self.records for name in record.names)
        object.__setattr__(self, "names", tuple(every))

    @property
    def known(self) -> tuple[Truths, ...]:
        """Which values of each record are no gaps, (n, outputs)."""
        return tuple(np.isfinite(record.values) for record in self.records)

    @property
    def samples(self) -> int:
        """Number of measured values."""
        return sum(int(known.sum()) for known in self.known)

    @property
    def outputs(self) -> Vector:
        """Position of the output of each residual among `names`, (samples,)."""
        found = []
        for record, known in zip(self.records, self.known, strict=True):
            places = np.array([self.names.index(name) for name in record.names])
            found.append(np.broadcast_to(places, known.shape)[known])
        return np.concatenate(found)

    def _largest(self, name: str) -> float:
        """Return the largest size of all measurements of an output."""
        rows = (record[name] for record in self.records if name in record)
        return max(float(np.abs(row[np.isfinite(row)]).max(initial=0.0)) for row in rows)

    def reject_overflow(self) -> None:
        """Reject measurements whose squares exceed what doubles hold."""
        most = max(map(self._largest, self.names))
        if not np.isfinite(most * most * self.samples):
            raise ParameterError(
                f"fit: {most:g} is measured, and the squares of these measurements have no size; "
                "correct the record"
            )

    def noise(self, given: Mapping[str, float] | None) -> Vector:
        """Return the noise of each output: given, or its size to begin with, (outputs,).

        That is the nominal value, or the largest measurement if it is smaller.
        """
        if given is None:
            nominal = (self.subject.column(name).nominal for name in self.names)
            pairs = zip(self.names, nominal, strict=True)
            return np.array([min(size, self._largest(name) or size) for name, size in pairs])
        UnknownName.reject("fit: noise", "measured variable", self.names, *given)
        missing = [name for name in self.names if name not in given]
        if missing:
            raise UsageError(f"fit: the noise of {missing[0]} is missing; give it, too")
        return np.array([number("fit: noise", n, given[n], positive=True) for n in self.names])

    def values(self, x: Vector, record: int) -> dict[str, float]:
        """Return all values of the run of a record by name."""
        own = self.unknowns.of_scaled(x).tolist()
        return {**self.fixed, **{n: own[i] for n, i in self.unknowns.of_record(record).items()}}

    def residuals(self, x: Vector) -> Vector:
        """Return run minus measurement, SI, (samples,)."""
        found = []
        for i, (record, known) in enumerate(zip(self.records, self.known, strict=True)):
            own = self.subject.run(self.values(x, i), record.names, record.time)
            if len(own) < len(record):
                raise SolverError(f"{self.subject.name}: the run stops before the last measurement")
            found.append((own.values - record.values)[known])
        return np.concatenate(found)

    def slopes(self, x: Vector) -> Vector:
        """Return the derivatives of the residuals by the scaled unknowns, (samples, unknowns)."""
        found = []
        for i, (record, known) in enumerate(zip(self.records, self.known, strict=True)):
            places, values = self.unknowns.of_record(i), self.values(x, i)
            own = self.subject.slopes(values, tuple(places), record.names, record.time)
            rows = np.zeros((int(known.sum()), len(x)))
            rows[:, [*places.values()]] = own[known]
            found.append(rows)
        return np.concatenate(found) * self.unknowns.sizes

    def solved(
        self, minimize: Any, start: Vector, noise: Vector, loss: str, estimated: bool
    ) -> _Solution:
        """Minimize from one start; repeat with estimated noise until that settles."""
        places, sizes = self.outputs, self.unknowns.sizes
        x, bounds = start / sizes, (self.unknowns.low / sizes, self.unknowns.high / sizes)
        self.residuals(x)  # a run that fails at the start is an error
        again = estimated and (len(self.names) > 1 or loss != "linear")  # weights matter
        free = np.ones(len(x), dtype=bool)
        if estimated:
            minimum = EPS * noise
            noise = np.fmax(self._estimated(self.residuals(x), loss, free), minimum)
        for _ in range(REWEIGHTINGS):
            found, missing = self._minimized(minimize, x, bounds, 1 / noise[places], loss)
            x, free = found.x, self._free(found.x, found.grad)
            if not estimated:
                break
            last, noise = noise, np.fmax(self._estimated(self.residuals(x), loss, free), minimum)
            if not again or np.all(np.abs(noise - last) <= SETTLED * last):
                break
        cost = float(np.log(noise[places]).sum()) if estimated else float(found.cost)
        jacobian = self.slopes(x) / noise[places][:, None]
        why = "" if found.success else str(found.message)
        return _Solution(x, free, cost, jacobian, noise, missing or why)

    def _minimized(
        self, minimize: Any, x: Vector, bounds: Any, weights: Vector, loss: str
    ) -> tuple[Any, str]:
        """Minimize from scaled values on; return also what is missing to the minimum, if anything.

        Where the minimum is far off, the first, short steps of the minimizer change the cost too
        little, and it takes that for the end.
        """
        best = None
        for _ in range(FURTHER):
            try:
                found = minimize(
                    lambda x: self._or_infinite(x) * weights,
                    np.clip(x, *bounds),
                    lambda x: self.slopes(x) * weights[:, None],
                    bounds=bounds,
                    x_scale="jac",
                    loss=loss,
                    xtol=TOLERANCE,
                    ftol=TOLERANCE,
                    gtol=TOLERANCE,
                )
            except SolverError:
                if best is None:
                    raise
                break
            if best is not None and not found.cost < best.cost:
                return best, ""
            best = found
            step, errors = self._ahead(found)
            if errors < CONVERGED or np.all(np.abs(step) <= ROUNDED * np.abs(found.x)):
                return found, ""
            x = np.clip(found.x + step, *bounds)
            if not np.isfinite(self._or_infinite(x)).all():
                break
        return best, f"the minimum is about {errors:.2g} standard errors off; begin closer to it"

    def _ahead(self, found: Any) -> tuple[Vector, float]:
        """Return the Gauss-Newton step from scaled values, and its length in standard errors."""
        free = self._free(found.x, found.grad)
        norms = np.linalg.norm(found.jac, axis=0)
        norms[norms == 0] = 1.0
        _, singular, rows = np.linalg.svd(found.jac[:, free] / norms[free], full_matrices=False)
        kept = singular > RANK * singular.max(initial=0.0)
        parts = rows[kept] @ (found.grad / norms)[free] / singular[kept]
        step = np.zeros(len(free))
        step[free] = -(rows[kept].T @ (parts / singular[kept])) / norms[free]
        spread = np.sqrt(2 * found.cost / max(len(found.fun) - len(free), 1))
        return step, float(np.linalg.norm(parts) / spread) if spread else 0.0

    def _free(self, x: Vector, slope: Vector) -> Truths:
        """Tell which scaled values are not at a bound that the slope of the cost leads beyond."""
        low, high = (ends / self.unknowns.sizes for ends in (self.unknowns.low, self.unknowns.high))
        near = 1e-6 * np.fmin(high - low, 1.0)
        return ~(((x - low <= near) & (slope > 0)) | ((high - x <= near) & (slope < 0)))

    def _or_infinite(self, x: Vector) -> Vector:
        """Return the residuals; infinity where the run fails, so that the step is shortened."""
        try:
            return self.residuals(x)
        except (SolverError, InitialConditionError):
            return np.full(self.samples, np.inf)

    def _estimated(self, residuals: Vector, loss: str, free: Truths) -> Vector:
        """Return the standard deviation of the residuals of each output, (outputs,)."""
        share = 1 - free.sum() / self.samples  # of the degrees of freedom
        found = np.empty(len(self.names))
        for i in range(len(self.names)):
            own = residuals[self.outputs == i]
            if loss == "linear":
                found[i] = np.sqrt(np.mean(own**2) / share)
            else:
                found[i] = NORMAL * np.median(np.abs(own)) / np.sqrt(share)
        return found

    def result(self, best: _Solution, confidence: float, reach: float, notes: Sequence[str]) -> Fit:
        """Return the values with their confidence, and what is not identified.

        Values at a bound count as known.
        """
        sizes, free = self.unknowns.sizes, best.free
        norms = np.linalg.norm(best.jacobian, axis=0)
        shown = norms * np.fmax(np.abs(best.x), 1.0) > RANK  # by a change of its own size
        relative = np.divide(1.0, norms, out=np.ones(len(norms)), where=shown)
        jacobian = (best.jacobian * relative)[:, free]
        _, singular, rows = np.linalg.svd(jacobian, full_matrices=True)
        rank = int((singular > RANK * singular.max(initial=0.0)).sum())
        identified = rows[:rank].T / np.where(rank, singular[:rank], 1.0)
        own = identified @ identified.T
        lost = rows[rank:]
        unknown = (np.abs(lost) > RANK).any(axis=0)
        own[unknown] = own[:, unknown] = np.nan
        own[np.diag_indices(len(own))] = np.where(unknown, np.inf, np.diag(own))
        covariance = np.full((len(sizes), len(sizes)), np.nan)
        covariance[np.ix_(free, free)] = own
        scales = relative * sizes
        values = [self.values(best.x, i) for i in range(len(self.records))]
        runs = tuple(
            self.subject.run(own, r.names, r.time)
            for own, r in zip(values, self.records, strict=True)
        )
        jumps = self._at_jumps(best.x, np.sqrt(np.diag(covariance)) * relative, runs)
        return Fit(
            columns=self.unknowns.columns,
            x=self.unknowns.of_scaled(best.x),
            covariance=covariance * scales * scales[:, None],
            confidence=confidence,
            reach=reach,
            rank=rank,
            unidentified=self._not_identified(free, lost),
            notes=(*notes, *self._late(), *jumps, *self._at_bounds(best)),
            noise=dict(zip(self.names, best.noise.tolist(), strict=True)),
            samples=self.samples,
            start_values=self.fixed,
            settled=values[0],
            records=self.records,
            runs=runs,
            subject=self.subject,
        )

    def _not_identified(self, free: Truths, lost: Vector) -> tuple[str, ...]:
        """Return sentences on combinations that change no residual, (combinations, free ones)."""
        if not len(lost):
            return ()
        places = np.flatnonzero(free)[np.abs(lost).max(axis=0) > SHARE]
        names = [self.unknowns.names[place] for place in places]
        if len(names) == len(lost):
            return (f"not identified: {', '.join(names)} (the measurements do not depend on it)",)
        left = counted(len(names) - len(lost), "combination")
        several = f"of {', '.join(names)} only {left}; fix {len(lost)} of these values"
        return (f"not identified: {several}",)

    def _late(self) -> list[str]:
        """Return sentences on records that begin later after the run than they are long."""
        return [
            f"{record.model} begins {record.time[0]:.6g} s after the run, which begins at 0; if "
            "its times count from elsewhere, shift them (time_offset, --time-offset)"
            for record in self.records
            if record.time[0] > record.time[-1] - record.time[0]
        ]

    def _at_jumps(self, x: Vector, errors: Vector, runs: Sequence[Trajectory]) -> list[str]:
        """Return a sentence on measurements that a jump passes by within the errors of the values.

        There, the residuals have no slope, and the minimizer may end.
        """
        steps = np.diag(errors)[np.isfinite(errors)]
        neighbors = [*(x - steps), *(x + steps)]
        passed = set[float]()
        for i, (record, run) in enumerate(zip(self.records, runs, strict=True)):
            before = _jumps_before(run, record.time)
            for near in neighbors if before.any() else ():
                with suppress(SolverError, InitialConditionError):
                    other = self.subject.run(self.values(near, i), record.names, record.time)
                    after = _jumps_before(other, other.time)
                    passed |= {*other.time[after != before[: len(after)]]}
        if not passed:
            return []
        which = f"{counted(len(passed), 'measurement')}, the first at {min(passed):.6g} s"
        return [
            f"a jump comes before or after {which}, depending on values within their errors, which "
            "may have stopped the fit there; leave measurements at jumps out"
        ]

    def _at_bounds(self, best: _Solution) -> list[str]:
        low, high = self.unknowns.low, self.unknowns.high
        x = self.unknowns.of_scaled(best.x)
        bounds = np.where(x - low <= high - x, low, high)
        found = [
            f"{c.name} ends at its bound {with_unit(float(c.shown(bound)), c.shown_unit)} and has "
            "no error; those of other values hold for this one"
            for c, bound, free in zip(self.unknowns.columns, bounds, best.free, strict=True)
            if not free
        ]
        return [f"the fit did not converge: {best.missing}", *found] if best.missing else found


def _jumps_before(run: Trajectory, times: Vector) -> Integers:
    """Return at how many events before each time a variable of a run has jumped, (n,)."""
    jumps = [e.time for e in run.events if any(e.before[n] != e.after[n] for n in run.names)]
    return np.searchsorted(jumps, times, side="right")


EPS = 1e-12  # least noise of an output, in its size, so that exact records have weights


def _records(subject: Subject, measured: Any) -> tuple[Trajectory, ...]:
    """Return the records, whose variables are outputs in the model's units.

    Raises:
        UnknownName, UsageError: A record is none, is empty, or has a variable that does not fit.
    """
    found = (measured,) if isinstance(measured, Trajectory) else tuple(measured)
    if not found or not all(isinstance(record, Trajectory) for record in found):
        raise UsageError.of_type("fit: measured", measured, "results of Trajectory.read_csv")
    for record in found:
        if not len(record) or not record.names:
            raise UsageError(f"fit: {record.model} holds no measurement")
        if record.time[0] < 0:
            raise ParameterError(
                f"fit: {record.model} begins at {record.time[0]:g} s, before the run; shift its "
                "times (time_offset of read_csv, --time-offset)"
            )
        if (again := np.diff(record.time) <= 0).any():
            raise ParameterError(
                f"fit: {record.model} has two measurements at {record.time[again.argmax()]:g} s; "
                "keep one of them"
            )
        for column in record.columns:
            unit = subject.column(column.name).unit
            if column.unit not in (unit, ""):
                raise UsageError(
                    f"fit: {column.name} is measured in '{column.unit}', but '{unit}' in "
                    f"{subject.name}; give the unit of the column"
                )
    return found
