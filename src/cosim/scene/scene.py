"""`Scene`: a model, the numbers it runs with, what is wanted of it, and how it shall be drawn."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from casadi_models.dae import Dae, Start, Variable
from cosim.errors import ParameterError
from cosim.integrate.solver import Tolerance
from cosim.model.inputs import InputSeries
from cosim.model.values import assign, number, plain_values
from cosim.scene.goals import OVERRULED, refuse_contradiction
from cosim.text.tables import html_table, text_table

WIDTH = 100  # letters of a line at a prompt


@dataclass(frozen=True)
class Settings:
    """How a scene runs; the model's or the solver's own where None.

    Attributes:
        start_time, stop_time, output_interval: s.
        solver: A name of `SOLVERS`.
        relative_tolerance, absolute_tolerance: Error per step; the absolute one in nominal values.
        step_size: Largest step of the fixed-step solvers, s.
        accuracy: Instead of these: largest global error of the outputs, in nominal values.
        budget: Instead of these: time that the solver may take, s.

    Raises:
        ParameterError: The run would end before it begins; or a number is not finite or positive.
        UsageError: Two things are given of which one decides on the other.

    Example:
        >>> Settings(stop_time=2.0, solver="erk", relative_tolerance=1e-6).stop_time
        2.0
    """

    start_time: float = 0.0
    stop_time: float | None = None
    output_interval: float | None = None
    solver: str | None = None
    relative_tolerance: float | None = None
    absolute_tolerance: float | None = None
    step_size: float | None = None
    accuracy: float | None = None
    budget: float | None = None

    def __post_init__(self) -> None:
        fixed = {name: getattr(self, name) for name in OVERRULED}
        refuse_contradiction(self.accuracy, self.budget, **fixed)
        number("run", "start_time", self.start_time)
        for name in ("stop_time", "output_interval", "step_size"):
            if (value := getattr(self, name)) is not None:
                number("run", name, value, positive=name != "stop_time")
        given = {"relative": self.relative_tolerance, "absolute": self.absolute_tolerance}
        if given := {name: value for name, value in given.items() if value is not None}:
            Tolerance(**given)  # refuses nonsense, also where no solver takes it
        if self.stop_time is not None and self.stop_time < self.start_time:
            raise ParameterError(
                f"stop_time = {self.stop_time:g} s lies before start_time = "
                f"{self.start_time:g} s; give a later stop"
            )


@dataclass(frozen=True)
class FigureSpec:
    """One figure: panels from top to bottom, each with one or more curves.

    Attributes:
        title: What stands above it.
        panels: Names of variables, a tuple for each panel.
        x: What the curves are drawn over; "time", or a variable for a path.
        x_label: What stands at the horizontal axis; the variable's name when empty.
        equal: Whether one metre is as long on both axes.
        labels: What stands at the vertical axes, one per panel; the variables' names when empty.
        legends: What the curves are called, a tuple for each panel; their meaning when empty.

    Example:
        >>> FigureSpec("lean and steer", (("phi", "delta"), ("psi",))).names
        ('phi', 'delta', 'psi')
    """

    title: str
    panels: tuple[tuple[str, ...], ...]
    x: str = "time"
    x_label: str = ""
    equal: bool = False
    labels: tuple[str, ...] = ()
    legends: tuple[tuple[str, ...], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The variables that the figure needs, each once."""
        across = () if self.x == "time" else (self.x,)
        return tuple(dict.fromkeys((*across, *(name for panel in self.panels for name in panel))))


@dataclass(frozen=True, eq=False)  # a Dae has no equality
class Scene:
    """A model with everything that one run of it needs.

    Attributes:
        name: How the scene is called, e.g. "bicycle_model_1".
        dae: The full model as its author wrote it.
        title: One line of text.
        values: Parameters, start values and constant inputs that replace the model's own, SI.
        inputs: Time series of other inputs.
        outputs: What shall be computed; everything when empty.
        settings: Span, solver and tolerances.
        figures: What `cosim plot` draws.

    Raises:
        UnknownName, ParameterError, InitialConditionError: A value does not fit; see `assign`.

    Example:
        >>> import cosim
        >>> scene = Scene("slow", cosim.load("crank_shaft"), values={"omega": 10.0})
        >>> cosim.run_scene(scene)["omega"][0]
        np.float64(10.0)
    """

    name: str
    dae: Dae
    title: str = ""
    values: Mapping[str, float] = field(default_factory=dict)
    inputs: InputSeries | None = None
    outputs: tuple[str, ...] = ()
    settings: Settings = Settings()
    figures: tuple[FigureSpec, ...] = ()

    def __post_init__(self) -> None:
        assign(self.dae, self.values)

    def rows(self) -> list[dict[str, str]]:
        """Return what the scene sets, as pairs of a word and a text."""
        settings = self.settings.__dataclass_fields__
        own = {name: getattr(self.settings, name) for name in settings}
        own = {name: value for name, value in own.items() if value != settings[name].default}
        units = {v.name: v.unit for v in self.dae.variables}
        facts = {
            "model": self.dae.full_name,
            "values": ", ".join(f"{n} = {v:g} {units[n]}" for n, v in self.values.items()),
            "inputs": ", ".join(self.inputs.names) if self.inputs else "",
            "outputs": ", ".join(self.outputs) or "everything",
            "run": ", ".join(f"{name} = {value}" for name, value in own.items()),
            "figures": ", ".join(figure.title for figure in self.figures),
        }
        return [{"of the scene": key, "is": text} for key, text in facts.items() if text]

    def __repr__(self) -> str:
        return f"{self._title()}\n{text_table(self.rows(), width=WIDTH)}"

    def _repr_html_(self) -> str:
        return html_table(self.rows(), self._title())

    def _title(self) -> str:
        return f"Scene {self.name}: {self.title}".rstrip(": ")

    def configured(self) -> Dae:
        """Return the full model with the scene's values and span as its own.

        Reduced, exported or integrated, it needs no further numbers.
        """
        dae, settings = self.dae, self.settings
        experiment = dae.experiment
        if settings.stop_time is not None and settings.stop_time > 0:
            experiment = replace(experiment, stop_time=settings.stop_time)
        if settings.output_interval is not None:
            experiment = replace(experiment, output_interval=settings.output_interval)
        starts = zip(dae.states, dae.x_start, strict=True)
        values = plain_values(dae, self.values)
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
