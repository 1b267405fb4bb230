"""`RunRequest`: what to simulate, as one value that is independent of the backend."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import TypeVar

from casadi_models.dae import Dae, Start, Variable
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.model.catalogue import observable
from cosim.model.inputs import InputSeries
from cosim.model.reduction import checked_outputs, reduce
from cosim.model.solver import AdaptiveSolver, Goal, Solver, Tolerance
from cosim.model.times import Times
from cosim.model.values import Values, assign, plain_values


class OnInvalid(StrEnum):
    """What happens if a run violates a validity condition of its model."""

    WARN = "warn"  # `stats["invalid"]` reports it
    STOP = "stop"  # the run ends at that time
    IGNORE = "ignore"  # validity conditions are not evaluated


class DriftControl(StrEnum):
    """How drift is limited from constraints of which only the derivatives are equations."""

    NONE = "none"
    BAUMGARTE = "baumgarte"  # the model's stabilization rate
    PROJECTION = "projection"  # onto the constraints, after every step


Choice = TypeVar("Choice", bound=StrEnum)


def choice(kind: type[Choice], what: str, name: object) -> Choice:
    """Return the member of an enum by its name.

    Raises:
        UnknownName: There is no member of that name.
    """
    try:
        return kind(str(name) if isinstance(name, str) else "")
    except ValueError:
        raise UnknownName.among("cosim", what, str(name), list(kind)) from None


@dataclass(frozen=True)
class Policy:
    """Settings of a run other than its solver.

    Attributes:
        on_invalid: What happens if the run violates a validity condition of the model, or a fixed
            step is too long for the motion.
        drift_control: How drift from constraints is limited; as the model is built when None.
        compiled: Whether the equations are compiled; small models are when None.
        stop_when: A condition that ends the run when it becomes true.
        record_events: Whether a run has rows just before and after each event.

    Raises:
        UnknownName: A choice does not exist.

    Example:
        >>> Policy(drift_control="projection").projects
        True
    """

    on_invalid: OnInvalid = OnInvalid.WARN
    drift_control: DriftControl | None = None
    compiled: bool | None = None
    stop_when: str | None = None
    record_events: bool = False

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        answer = choice(OnInvalid, "answer to an invalid state", self.on_invalid)
        set_field(self, "on_invalid", answer)
        if self.drift_control is not None:
            control = choice(DriftControl, "drift control", self.drift_control)
            set_field(self, "drift_control", control)
        UsageError.reject("compiled", self.compiled, bool | None, "True, False or None")

    @property
    def projects(self) -> bool:
        """Whether every step is projected onto the constraints."""
        return self.drift_control is DriftControl.PROJECTION


@dataclass(frozen=True, eq=False)  # a Dae has no equality
class RunRequest:
    """What to simulate: a model, its values, the output times and the settings, for any backend.

    Attributes:
        dae: The model; inputs that are formulas of time are part of its equations.
        values: Initial values, parameters and constant inputs by name that replace the model's, SI.
        times: Output times.
        outputs: Names to record; everything but monitors when None.
        inputs: Time series of some inputs; the others are constant.
        solver: A solver; a tolerance for the model's default solver (CVODES for an ODE, IDAS for a
            DAE); a goal, which is resolved before a run; all defaults when None.
        policy: Settings other than the solver.

    Raises:
        UnknownName: A value, an output or an input series has a name that the model does not have.
        ParameterError: A value is not finite or out of its bounds, or an inertia is not physical.
        InitialConditionError: A start value is set that follows from others.
        UsageError: An output is named twice, or a field has a wrong type.

    Example:
        >>> import cosim
        >>> request = RunRequest(cosim.load("crank_shaft"), {"omega": 10.0}, Times(stop=1.0))
        >>> round(cosim.simulate(request).final["omega"], 6)
        20.0
    """

    dae: Dae
    values: Mapping[str, float] = field(default_factory=dict)
    times: Times = field(default_factory=Times)
    outputs: tuple[str, ...] | None = None
    inputs: InputSeries | None = None
    solver: Solver | Tolerance | Goal | None = None
    policy: Policy = Policy()

    def __post_init__(self) -> None:
        self.numbers  # noqa: B018  # checks every value
        if self.outputs is not None:
            object.__setattr__(self, "outputs", checked_outputs(self.dae, self.outputs))
        if not isinstance(self.inputs, InputSeries | None):
            owner, expected = f"{self.dae.full_name}: inputs", "what read_inputs returns"
            raise UsageError.of_type(owner, self.inputs, expected)
        known = [variable.name for variable in self.dae.inputs]
        UnknownName.reject(
            self.dae.full_name, "input", known, *(self.inputs.names if self.inputs else ())
        )

    @cached_property
    def numbers(self) -> Values:
        """States (with initial guesses), parameters and inputs as arrays, in the model's order."""
        return assign(self.dae, self.values)

    @property
    def tolerance(self) -> Tolerance | None:
        """Tolerance of the solver; None for fixed steps, a goal, or the default tolerance."""
        if isinstance(self.solver, AdaptiveSolver):
            return self.solver.tolerance
        return self.solver if isinstance(self.solver, Tolerance) else None

    @property
    def relative_tolerance(self) -> float | None:
        """Relative tolerance of the solver; None where there is no `tolerance`."""
        return None if self.tolerance is None else self.tolerance.relative

    @property
    def max_step(self) -> float | None:
        """Longest step of the solver, s; None if the request sets none."""
        return getattr(self.solver, "max_step", None)

    def without_series(self, names: Collection[str]) -> "RunRequest":
        """Return the request without the time series of inputs that get values."""
        varying = {variable.name for variable in self.dae.inputs}.difference(names)
        return replace(self, inputs=self.inputs and self.inputs.only(varying))

    def reduced(self) -> "RunRequest":
        """Return the request with the model reduced to what outputs and stop condition require."""
        if self.outputs is None:
            return self
        values, dae = plain_values(self.dae, self.values), self.dae
        words = re.findall(r"\w+", self.policy.stop_when or "")
        needed = (*self.outputs, *(name for name in observable(dae) if name in words))
        small = reduce(dae, tuple(dict.fromkeys(needed)))
        known = {v.name for v in (*small.states, *small.parameters, *small.inputs)}
        return replace(
            self,
            dae=small,
            values={name: value for name, value in values.items() if name in known},
            inputs=self.inputs and self.inputs.only({v.name for v in small.inputs}),
        )

    def reject_instant(self) -> None:
        """Raise a ParameterError for a run that ends as it begins."""
        begin, end = self.times.span(self.dae)
        if end == begin:
            ends = f"{self.dae.full_name}: stop_time = {end:g} s is the start of the run"
            raise ParameterError(f"{ends}; give a later one")

    def configured(self) -> Dae:
        """Return the model with the request's values, span and interval as defaults, for export.

        The run that a model is shown with begins at 0, whatever the start time of the request.
        """
        dae, times = self.dae, self.times
        span = 0.0 if times.stop is None else times.stop - times.start
        experiment = replace(
            dae.experiment,
            stop_time=span or dae.experiment.stop_time,
            output_interval=times.interval or dae.experiment.output_interval,
        )
        values = plain_values(dae, self.values)
        starts = zip(dae.states, dae.x_start, strict=True)
        return replace(
            dae,
            states=_with_starts(dae.states, values),
            parameters=_with_starts(dae.parameters, values),
            inputs=_with_starts(dae.inputs, values),
            x_start=tuple(values.get(v.name, start) for v, start in starts),
            experiment=experiment,
        )


def _with_starts(
    variables: tuple[Variable, ...], values: Mapping[str, float]
) -> tuple[Variable, ...]:
    return tuple(
        replace(v, start=values[v.name]) if v.name in values and v.start_kind is Start.EXACT else v
        for v in variables
    )
