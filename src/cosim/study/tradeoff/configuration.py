"""What is measured: configurations, and the selection of them that a user asks for."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from casadi_models.dae import Dae
from cosim.errors import ParameterError, UnknownName
from cosim.integrate.drift_control import DRIFT_CONTROLS, controllable
from cosim.integrate.solver import Tolerance
from cosim.integrate.solvers import SOLVERS
from cosim.model.values import number
from cosim.scene.roads import Road

TOLERANCES = tuple(float(f"1e-{i}") for i in range(2, 13))
STEPS = (10.0, 5.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # of fixed-step solvers, in output intervals
UNROLLED = 5  # of them are measured interpreted: CasADi unrolls the steps, for half a minute
COMMUNICATION = (1.0, 10.0)  # steps of co-simulation, in output intervals
Family = tuple[str, bool, Road, str, str | None]  # model, reduced, road, solver, drift control


@dataclass(frozen=True)
class Configuration:
    """One way to compute a scene.

    Attributes:
        model: `MODEL/FORMULATION`.
        reduced: Whether the model is reduced to the wanted outputs.
        road: A `Road`, or its name.
        solver: A name of `SOLVERS`; of an FMU, what integrates it.
        tolerance: Relative tolerance of an adaptive solver.
        step: Step of a fixed-step solver, or from one communication point to the next, s.
        drift_control: One of `DRIFT_CONTROLS`; the model's own when None.
    """

    model: str
    reduced: bool
    road: Road
    solver: str
    tolerance: float | None = None
    step: float | None = None
    drift_control: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "road", Road.named(self.road))

    def __str__(self) -> str:
        size = " (kept outputs only)" if self.reduced else ""
        control = "" if self.drift_control is None else f" (drift: {self.drift_control})"
        return f"{self.model}{size}{control} {self.road} {self.solver} {self.setting}"

    @property
    def setting(self) -> str:
        """Tolerance and step."""
        tolerance = "" if self.tolerance is None else f"{self.tolerance:.0e}"
        step = "" if self.step is None else f"{self.step:.4g} s"
        return f"{tolerance} {step}".strip()

    @property
    def short(self) -> str:
        """The configuration without the model's name."""
        return str(self).removeprefix(f"{self.model.partition('/')[0]}/")

    @property
    def family(self) -> Family:
        """What configurations share that differ in tolerance and step only."""
        return self.model, self.reduced, self.road, self.solver, self.drift_control


@dataclass(frozen=True)
class Selection:
    """Which configurations a user wants; the default is all of them.

    Attributes:
        solvers: Names of `SOLVERS`; all of them when empty.
        tolerances: Relative tolerances; a decade apart from 1e-2 to 1e-12 when empty.
        steps: Of fixed-step solvers, s; from ten output intervals to an eighth when empty.
        roads: Roads, or their names; all that work here when empty.
        drift_controls: Of `DRIFT_CONTROLS`, for CasADi's integrators; the model's own when empty.

    Raises:
        UnknownName: A solver, a road or a drift control does not exist.
        ParameterError: A tolerance or a step is out of range.
    """

    solvers: tuple[str, ...] = ()
    tolerances: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    roads: tuple[Road | str, ...] = ()
    drift_controls: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for kind, names, known in (
            ("solver", self.solvers, SOLVERS),
            ("drift control", self.drift_controls, DRIFT_CONTROLS),
        ):
            for name in names:
                if name not in known:
                    raise UnknownName.among("cosim tradeoff", kind, name, known)
        roads = tuple(dict.fromkeys(Road.named(road, "cosim tradeoff") for road in self.roads))
        object.__setattr__(self, "roads", roads)
        for tolerance in self.tolerances:
            if Tolerance(tolerance).relative == 0:
                raise ParameterError("a relative tolerance of 0 leaves nothing to vary")
        for step in self.steps:
            number("tradeoff", "step", step, positive=True)

    @property
    def ways(self) -> tuple[Road, ...]:
        """The roads that are wanted."""
        return tuple(Road(road) for road in self.roads) or tuple(Road)

    def configurations(
        self, dae: Dae, small: Dae | None, span: float, interval: float
    ) -> Iterator[Configuration]:
        """Yield what is to be measured of one formulation.

        Args:
            dae: The full model.
            small: The reduced one, where there is one.
            span, interval: Length of the run and distance of its outputs, s.
        """
        for reduced, model in ((False, dae), (True, small)):
            if model is None:
                continue
            for road in self.ways:
                if road.native:
                    for plain in self._integrators(dae, reduced, road, span, interval):
                        for control in self._drift_controls(model, plain):
                            yield replace(plain, drift_control=control)
                elif not self.solvers:
                    yield from self._fmus(dae, reduced, road, span, interval)

    def impossible(self, dae: Dae) -> Iterator[tuple[str, str]]:
        """Yield what of the selection is not measured of one formulation, and the reason."""
        solvers, roads = self.solvers or tuple(SOLVERS), self.ways
        unable = [s for s in solvers if dae.algebraics and not SOLVERS[s].solves_dae]
        if unable and any(road.native for road in roads):
            yield f"{dae.full_name} {', '.join(unable)}", "cannot integrate algebraic unknowns"
        compiled = [s for s in solvers if SOLVERS[s].compiled_only]
        if Road.INTERPRETED in roads and compiled:
            what = f"{dae.full_name} {Road.INTERPRETED} {', '.join(compiled)}"
            yield what, "exists as compiled code only"
        fixed = [s for s in solvers if not SOLVERS[s].adaptive and s not in unable]
        if Road.INTERPRETED in roads and fixed and not self.steps:
            what = f"{dae.full_name} {Road.INTERPRETED} {', '.join(fixed)} in smaller steps"
            yield what, "CasADi unrolls the steps, which takes far longer than to run them"
        if refused := [c for c in self.drift_controls if not controllable(dae, c)]:
            yield f"{dae.full_name} {', '.join(refused)}", "the model cannot drift or be controlled"
        if "projection" in self.drift_controls:
            others = [s for s in solvers if not SOLVERS[s].projects]
            yield f"{dae.full_name} projection, {', '.join(others)}", "do not project their steps"

    def _drift_controls(self, dae: Dae, plain: Configuration) -> Iterator[str | None]:
        """Yield the drift controls that a model and a solver can have."""
        if not self.drift_controls:
            yield None
        for control in self.drift_controls:
            able = SOLVERS[plain.solver].projects and plain.road is Road.NATIVE
            if controllable(dae, control) and (able or control != "projection"):
                yield control

    def _integrators(
        self, dae: Dae, reduced: bool, road: Road, span: float, interval: float
    ) -> Iterator[Configuration]:
        for name in self.solvers or SOLVERS:
            if dae.algebraics and not SOLVERS[name].solves_dae:
                continue
            if SOLVERS[name].compiled_only and road is Road.INTERPRETED:
                continue
            if SOLVERS[name].adaptive:
                for tolerance in self.tolerances or TOLERANCES:
                    yield Configuration(dae.full_name, reduced, road, name, tolerance)
            else:
                factors = STEPS if road == Road.NATIVE else STEPS[:UNROLLED]
                for step in self.steps or _dividing(factors, span, interval):
                    yield Configuration(dae.full_name, reduced, road, name, step=step)

    def _fmus(
        self, dae: Dae, reduced: bool, road: Road, span: float, interval: float
    ) -> Iterator[Configuration]:
        inside = "rosenbrock" if dae.algebraics else "erk"
        for tolerance in self.tolerances or TOLERANCES:
            if road == Road.MODEL_EXCHANGE:
                yield Configuration(dae.full_name, reduced, road, "cvode", tolerance)
                continue
            for step in _dividing(COMMUNICATION, span, interval):
                yield Configuration(dae.full_name, reduced, road, inside, tolerance, step)


def _dividing(factors: tuple[float, ...], span: float, interval: float) -> list[float]:
    """Return the multiples of the output interval that fit into the span a whole number of times.

    A step longer than the interval is measured on fewer output times.
    """
    points = span / interval
    return [f * interval for f in factors if f <= 1 or abs(points / f - round(points / f)) < 1e-6]
