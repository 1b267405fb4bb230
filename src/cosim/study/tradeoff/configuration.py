"""Configurations of a trade-off study, and the user's selection of them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

from casadi_models.dae import Dae
from cosim.backend import Backend
from cosim.codegen.fmu.solver import solver_for
from cosim.errors import ParameterError, UnknownName, naming_arguments_of
from cosim.integrate.preparation import controllable
from cosim.integrate.solvers import SOLVERS, requested_solver
from cosim.model.request import DriftControl, RunRequest, choice
from cosim.model.solver import Solver, Tolerance
from cosim.model.times import Times
from cosim.model.values import number

TOLERANCES = tuple(float(f"1e-{i}") for i in range(2, 13))
STEPS = (10.0, 5.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # of fixed-step solvers, in output intervals
UNROLLED = 5  # largest steps, also measured interpreted; CasADi unrolls smaller ones for too long
COMMUNICATION = (1.0, 10.0)  # steps of co-simulation, in output intervals
Family = tuple[str, bool, Backend, str, DriftControl | None]
# model, reduced, backend, solver, drift control


@dataclass(frozen=True)
class Configuration:
    """A request and the backend that executes it.

    Attributes:
        request: The run; for an FMU, its output interval is the communication step.
        backend: The backend that executes it.
        reduced: Whether the model is reduced to the selected outputs.
    """

    request: RunRequest
    backend: Backend
    reduced: bool = False

    def __str__(self) -> str:
        size = " (reduced)" if self.reduced else ""
        control = "" if self.drift_control is None else f" (drift: {self.drift_control})"
        return f"{self.model}{size}{control} {self.backend} {self.solver} {self.setting}"

    @property
    def model(self) -> str:
        """`MODEL/FORMULATION`."""
        return self.request.dae.full_name

    @property
    def solver(self) -> str:
        """Name of the solver; for an FMU, the solver of the importer or of the FMU itself."""
        if self.backend is Backend.MODEL_EXCHANGE:
            return "cvode"
        if self.backend is Backend.CO_SIMULATION:
            return solver_for(self.request.dae, None)
        assert isinstance(self.request.solver, Solver)
        return self.request.solver.name

    @property
    def tolerance(self) -> float | None:
        """Relative tolerance; None for fixed steps."""
        return self.request.relative_tolerance

    @property
    def step(self) -> float | None:
        """Step of a fixed-step solver, or communication step, s."""
        if self.backend is Backend.CO_SIMULATION:
            return self.request.times.interval
        return getattr(self.request.solver, "step_size", None)

    @property
    def drift_control(self) -> DriftControl | None:
        """Drift control; the model's own when None."""
        return self.request.policy.drift_control

    @property
    def setting(self) -> str:
        """Tolerance and step."""
        tolerance = "" if self.tolerance is None else f"{self.tolerance:.0e}"
        step = "" if self.step is None else f"{self.step:.4g} s"
        return f"{tolerance} {step}".strip()

    @property
    def family(self) -> Family:
        """Everything except tolerance and step; configurations of one family share it."""
        return self.model, self.reduced, self.backend, self.solver, self.drift_control


@naming_arguments_of
@dataclass(frozen=True)
class Selection:
    """The user's selection of configurations; the default is all of them.

    Attributes:
        solvers: Names of `SOLVERS` (empty: all of them).
        tolerances: Relative tolerances (empty: 1e-2 to 1e-12, a decade apart).
        steps: Steps of fixed-step solvers, s (empty: from ten output intervals to an eighth).
        backends: Backends, or their names (empty: all that work on this machine).
        drift_controls: Values of `DriftControl`, for CasADi's integrators (empty: the model's own).

    Raises:
        UnknownName: A solver, a backend or a drift control does not exist.
        ParameterError: A tolerance or a step is out of range.

    Example:
        >>> Selection(("erk",), tolerances=(1e-6,), backends=("native",)).used_backends
        (<Backend.NATIVE: 'native'>,)
    """

    solvers: tuple[str, ...] = ()
    tolerances: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    backends: tuple[Backend | str, ...] = ()
    drift_controls: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for kind, names, known in (
            ("solver", self.solvers, SOLVERS),
            ("drift control", self.drift_controls, tuple(DriftControl)),
        ):
            UnknownName.reject("cosim tradeoff", kind, known, *names)
        backends = tuple(dict.fromkeys(choice(Backend, "backend", name) for name in self.backends))
        object.__setattr__(self, "backends", backends)
        for tolerance in self.tolerances:
            if Tolerance(tolerance).relative == 0:
                raise ParameterError("a relative tolerance of 0 leaves nothing to vary")
        for step in self.steps:
            number("tradeoff", "step", step, positive=True)

    @property
    def used_backends(self) -> tuple[Backend, ...]:
        """The backends that are measured."""
        return tuple(Backend(backend) for backend in self.backends) or tuple(Backend)

    def configurations(self, full: RunRequest, small: RunRequest | None) -> Iterator[Configuration]:
        """Yield the configurations of one formulation, of the full and of the reduced model."""
        for reduced, request in ((False, full), (True, small)):
            if request is None:
                continue
            for backend in self.used_backends:
                if backend.native:
                    yield from self._native(request, backend, reduced)
                elif not self.solvers:
                    yield from self._fmus(request, backend, reduced)

    def impossible(self, dae: Dae) -> Iterator[tuple[str, str]]:
        """Yield the parts of the selection that one formulation does not allow, with the reason."""
        solvers, backends = self.solvers or tuple(SOLVERS), self.used_backends
        unable = [s for s in solvers if dae.algebraics and not SOLVERS[s].solves_dae]
        if unable and any(backend.native for backend in backends):
            yield f"{dae.full_name} {', '.join(unable)}", "cannot integrate algebraic unknowns"
        compiled = [s for s in solvers if SOLVERS[s].compiled_only]
        if Backend.INTERPRETED in backends and compiled:
            what = f"{dae.full_name} {Backend.INTERPRETED} {', '.join(compiled)}"
            yield what, "exists as compiled code only"
        fixed = [s for s in solvers if not SOLVERS[s].adaptive and s not in unable]
        if Backend.INTERPRETED in backends and fixed and not self.steps:
            what = f"{dae.full_name} {Backend.INTERPRETED} {', '.join(fixed)} in smaller steps"
            yield what, "CasADi unrolls the steps, which takes far longer than the run"
        if unable := [c for c in self.drift_controls if not controllable(dae, DriftControl(c))]:
            yield f"{dae.full_name} {', '.join(unable)}", "the model cannot drift or be controlled"
        if "projection" in self.drift_controls:
            others = [s for s in solvers if not SOLVERS[s].projects]
            yield f"{dae.full_name} projection, {', '.join(others)}", "do not project their steps"

    def _native(
        self, request: RunRequest, backend: Backend, reduced: bool
    ) -> Iterator[Configuration]:
        dae, (begin, end) = request.dae, request.times.span(request.dae)
        interval = request.times.interval or dae.experiment.output_interval
        compiled = backend is Backend.NATIVE
        for name in self.solvers or SOLVERS:
            kind = SOLVERS[name]
            if (dae.algebraics and not kind.solves_dae) or (kind.compiled_only and not compiled):
                continue
            if kind.adaptive:
                found = [
                    replace(request, solver=requested_solver(dae, name, tolerance))
                    for tolerance in self.tolerances or TOLERANCES
                ]
            else:
                factors = STEPS if compiled else STEPS[:UNROLLED]
                found = [
                    replace(
                        request,
                        solver=requested_solver(dae, name, step_size=step),
                        times=Times(begin, end, max(step, interval)),
                    )
                    for step in self.steps or _dividing(factors, end - begin, interval)
                ]
            for plain, control in product(found, self._drift_controls(dae, kind, backend)):
                policy = replace(plain.policy, compiled=compiled, drift_control=control)
                yield Configuration(replace(plain, policy=policy), backend, reduced)

    def _drift_controls(
        self, dae: Dae, kind: type[Solver], backend: Backend
    ) -> tuple[DriftControl | None, ...]:
        """Return the selected drift controls that a model and a solver support."""
        if not self.drift_controls:
            return (None,)
        able = kind.projects and backend is Backend.NATIVE
        return tuple(
            DriftControl(control)
            for control in self.drift_controls
            if controllable(dae, DriftControl(control))
            and (able or control != DriftControl.PROJECTION)
        )

    def _fmus(
        self, request: RunRequest, backend: Backend, reduced: bool
    ) -> Iterator[Configuration]:
        dae, (begin, end) = request.dae, request.times.span(request.dae)
        interval = request.times.interval or dae.experiment.output_interval
        exchange = backend is Backend.MODEL_EXCHANGE
        steps = [interval] if exchange else _dividing(COMMUNICATION, end - begin, interval)
        for tolerance, step in product(self.tolerances or TOLERANCES, steps):
            times = Times(begin, end, step)
            own = replace(request, solver=Tolerance(tolerance), times=times)
            yield Configuration(own, backend, reduced)


def _dividing(factors: tuple[float, ...], span: float, interval: float) -> list[float]:
    """Return the multiples of the output interval that fit into the span a whole number of times.

    A step longer than the interval is measured on fewer output times.
    """
    points = span / interval
    return [f * interval for f in factors if f <= 1 or abs(points / f - round(points / f)) < 1e-6]
