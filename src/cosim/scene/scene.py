"""`Scene`: a run with a name, a title and figures."""

from dataclasses import dataclass

from casadi_models.dae import Dae
from cosim.errors import UsageError, naming_arguments_of
from cosim.model.request import RunRequest
from cosim.model.solver import Solver
from cosim.text import html_table, text_table

WIDTH = 100  # characters per line at a prompt


@naming_arguments_of
@dataclass(frozen=True)
class FigureSpec:
    """One figure: panels from top to bottom, each with one or more curves.

    Attributes:
        title: Title above the figure.
        panels: Names of variables, a tuple for each panel.
        x: Variable of the horizontal axis: "time", or another one for a path.
        x_label: Label of the horizontal axis; the variable's name when empty.
        equal: Whether both axes have the same scale.
        labels: Labels of the vertical axes, one per panel; the variables' names when empty.
        legends: Names of the curves, a tuple for each panel; their meaning when empty.

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


@naming_arguments_of
@dataclass(frozen=True, eq=False)  # a Dae has no equality
class Scene:
    """A run with a name, a title and figures, as a TOML file describes it.

    Attributes:
        name: Name of the scene, e.g. "bicycle_model_1".
        request: The run: model, values, times, outputs, solver.
        title: One line of text.
        figures: Figures that `cosim plot` draws.
        model: What the model was loaded by: MODEL or PATH.py:FUNCTION; empty if that is unknown.

    Example:
        >>> import cosim
        >>> scene = Scene("slow", cosim.requested("crank_shaft", start_values={"omega": 10.0}))
        >>> cosim.run_scene(scene)["omega"][0]
        np.float64(10.0)
    """

    name: str
    request: RunRequest
    title: str = ""
    figures: tuple[FigureSpec, ...] = ()
    model: str = ""

    def __post_init__(self) -> None:
        expected = "what cosim.requested returns"
        UsageError.reject("Scene: request", self.request, RunRequest, expected)

    @property
    def dae(self) -> Dae:
        """The full model as its author wrote it."""
        return self.request.dae

    def rows(self) -> list[dict[str, str]]:
        """Return the contents of the scene, one row for each subject."""
        request = self.request
        units = {v.name: v.unit for v in self.dae.variables}
        facts = {
            "model": self.dae.full_name,
            "values": ", ".join(f"{n} = {v:g} {units[n]}" for n, v in request.values.items()),
            "inputs": ", ".join(request.inputs.names) if request.inputs else "",
            "outputs": ", ".join(request.outputs or ()) or "everything",
            "run": ", ".join(f"{name} = {value}" for name, value in run_settings(request).items()),
            "figures": ", ".join(figure.title for figure in self.figures),
        }
        return [{"of the scene": key, "is": text} for key, text in facts.items() if text]

    def __repr__(self) -> str:
        return f"{self._title()}\n{text_table(self.rows(), width=WIDTH)}"

    def _repr_html_(self) -> str:
        return html_table(self.rows(), self._title())

    def _title(self) -> str:
        return f"Scene {self.name}: {self.title}".rstrip(": ")


def run_settings(request: RunRequest) -> dict[str, object]:
    """Return the times and solver settings of a request that differ from the defaults."""
    times, solver = request.times, request.solver
    found: dict[str, object] = {
        "start_time": times.start or None,
        "stop_time": times.stop,
        "output_interval": times.interval,
        "solver": solver.name if isinstance(solver, Solver) else None,
    }
    found |= {} if solver is None else solver.numbers
    return {n: value for n, value in found.items() if value is not None and value is not False}
