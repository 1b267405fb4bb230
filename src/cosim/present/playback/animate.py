"""`animate`: runs in three dimensions, as a page that may compute, a movie or a still picture."""

import html as html_module
import os
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import ceil, pi, radians
from pathlib import Path
from typing import Any
from warnings import warn

import casadi as ca
import matplotlib
import numpy as np
from casadi import SX
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter

import casadi_models
from casadi_models.dae import Dae, Drawing, Start
from cosim.api import simulate
from cosim.codegen.c_sources import source_text
from cosim.codegen.casadi_library import generated
from cosim.drawing.camera import View
from cosim.drawing.picture import SIZE, Stage, canvas, draw_pose
from cosim.drawing.pose import POINT, Poses, motion
from cosim.errors import UnknownName, UsageError
from cosim.files import write_atomically
from cosim.fmi.export.build import compiled_library
from cosim.fmi.export.model_description import meant_bounds
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import files_of
from cosim.fmi.export.plan import Plan, planned
from cosim.fmi.export.variables import FmuVariable, Role
from cosim.fmi.platforms import WEB_PAGE
from cosim.host.optional_packages import optional_module
from cosim.host.progress import doing
from cosim.host.temporary import temporary_folder
from cosim.model.catalogue import loaded
from cosim.model.request import choice
from cosim.model.values import number
from cosim.plotting import picture, reject_pixels
from cosim.present.playback.page import column_facts, packages, packed
from cosim.present.playback.page import page as html_page
from cosim.present.playback.playback import FRAMES_PER_SECOND, playback
from cosim.series.samples import Column
from cosim.trajectory import Trajectory

_FASTEST_GIF = 50.0  # pictures per second; browsers show shorter ones for a tenth of a second


class AnimationFormat(StrEnum):
    """Kind of file that shows runs in three dimensions."""

    HTML = "html"
    MP4 = "mp4"
    GIF = "gif"
    PNG = "png"
    SVG = "svg"
    PDF = "pdf"

    @property
    def still(self) -> bool:
        """Whether the file is one picture that does not move."""
        return self in (AnimationFormat.PNG, AnimationFormat.SVG, AnimationFormat.PDF)

    @property
    def frames_per_second(self) -> float:
        """Smallest number of frames in a second of playback."""
        return {"gif": 15.0, "mp4": 25.0, "html": 100.0}.get(self, FRAMES_PER_SECOND)


@dataclass(frozen=True)
class Animation:
    """A page that plays a run; a notebook shows it, `save` writes it."""

    page: str

    def save(self, target: str | os.PathLike[str]) -> Path:
        """Write the page as one HTML file."""
        return write_atomically(target, self.page.encode())

    def _repr_html_(self) -> str:
        escaped = html_module.escape(self.page, quote=True)
        style = "border:none;width:100%;height:480px"
        return f'<iframe srcdoc="{escaped}" style="{style}"></iframe>'


def animate(
    runs: Trajectory | Sequence[Trajectory] | Dae,
    target: str | os.PathLike[str] | None = None,
    *,
    model: Dae | str | None = None,
    at: Sequence[float] | None = None,
    labels: Sequence[str] = (),
    view: View | str = View.ISO,
    follow: str | None = None,
    speed: float | None = None,
    size: tuple[float, float] = SIZE,
    dpi: int = 120,
) -> Path | Animation:
    """Show runs in three dimensions.

    Args:
        runs: One run, or several of one scene; all but the first are pale ghosts. A model makes a
            page that computes: it has sliders for start values, inputs and parameters.
        target: File name that ends with .html, .mp4, .gif, .png, .svg or .pdf; if None, the result
            is an object that a notebook shows.
        model: Model whose shapes are drawn, as a Dae or a name that `load` accepts, for runs that
            do not carry a drawing: those of an FMU, or read from a file. Their parameters are
            those in `run.numbers`, or else the model's own.
        at: Times of the poses of a still picture, s; earlier poses are pale. The start if None.
        labels: Variables to write beside the picture, in display units.
        view: Where the camera is at first: "iso", "front", "side" or "top".
        follow: Body that stays in the middle; the model's own choice if None, "" for a camera at
            rest.
        speed: Seconds of the run in a second of playback; if None, 1 or what eyes can
            follow: less if a body turns more than three times a second; the playback lasts 2 to
            60 s.
        size: Width and height of pictures and movies, inches.
        dpi: Dots per inch of pictures and movies.

    Returns:
        Path of the file, or the object.

    Raises:
        UsageError: The model declares no shapes or is not known; or the run did not record
            variables that place the bodies.
        UnknownName: There is no such format, view or variable.
        MissingTool: An optional package is not installed.
        ExportError: The file cannot be written.

    Example:
        >>> import cosim
        >>> animate(cosim.simulate("crank_shaft", stop_time=0.1), "crank.png").name
        'crank.png'
    """
    live = runs if isinstance(runs, Dae) else None
    kind = AnimationFormat.HTML if target is None else animation_format(target)
    look: dict[str, Any] = {"view": choice(View, "view", view), "follow": follow}
    if speed is not None and not (speed := number("animate", "speed", speed)) > 0:
        raise UsageError(f"animate: speed {speed:g} is not positive; give a number above 0")
    if at is not None and not kind.still:
        raise UsageError(f"animate: only a picture shows chosen times; name a .png, not a .{kind}")
    if live is not None and kind is not AnimationFormat.HTML:
        raise UsageError(f"animate: only a page computes; name an .html file, not .{kind}")
    reject_pixels(*size, dpi)
    reject_missing(kind, live=live is not None)
    shown = _shown(runs)
    times = None
    if kind.still:
        times = [float(time) for time in (shown[0].time[:1] if at is None else at)]
    rate: dict[str, Any] = {"frames_per_second": kind.frames_per_second, "speed": speed}
    played: list[Poses] = []
    for run in shown:
        if played and len(run):
            times = [min(max(t, run.time[0]), run.time[-1]) for t in played[0].time.tolist()]
        beside = () if played else labels
        drawing = drawing_of(run, model)
        if not drawing and kind is AnimationFormat.HTML:
            drawing = POINT
        played.append(playback(run, drawing, times=times, labels=beside, **rate))
        for note in played[-1].notes:
            warn(f"{run.model}: {note}", stacklevel=2)
    if kind.still:
        look["follow"] = follow or ""  # the camera of a still picture rests
        still = draw_pose(played, range(len(played[0].time)), size=size, **look)
        content = picture(still, kind, dpi)
    elif kind is AnimationFormat.HTML:
        solver = None if live is None else live_part(live, shown[0])
        page = Animation(html_page(played, shown, live=solver, **look))
        if target is None:
            return page
        content = page.page.encode()
    else:
        content = movie(played, kind, size=size, dpi=dpi, **look)
    assert target is not None
    return write_atomically(target, content)


def _shown(runs: Trajectory | Sequence[Trajectory] | Dae) -> list[Trajectory]:
    """Return the runs to show; of a model, its own run."""
    if isinstance(runs, Dae):
        return [simulate(runs)]
    shown = [runs] if isinstance(runs, Trajectory) else list(runs)
    if not shown or not all(isinstance(run, Trajectory) for run in shown):
        raise UsageError.of_type("animate", runs, "results of simulate or simulate_fmu")
    return shown


def animation_format(target: str | os.PathLike[str]) -> AnimationFormat:
    """Return the format of a file by the ending of its name."""
    kind = Path(target).suffix.lstrip(".").lower()
    try:
        return AnimationFormat(kind)
    except ValueError:
        endings = ", ".join(f".{known}" for known in AnimationFormat)
        raise UnknownName(
            f"{target} has no animation format '{kind}'; name a file that ends with {endings}"
        ) from None


def reject_missing(kind: AnimationFormat, *, live: bool) -> None:
    """Reject a format whose packages are missing, before anything is computed.

    Raises:
        MissingTool: A package is not installed.
    """
    if kind is AnimationFormat.HTML:
        packages("live" if live else "animate")
    elif kind is AnimationFormat.MP4:
        optional_module("imageio_ffmpeg", "animate")


class _GifWriter(PillowWriter):
    """Writes a GIF, whose pictures last whole hundredths of a second."""

    _frames: list[Any]

    def finish(self) -> None:
        """Write the file."""
        first, *others = self._frames
        ends = np.round(100 / self.fps * np.arange(2 + len(others)))
        lengths = (10 * np.diff(ends)).tolist()  # ms
        first.save(self.outfile, save_all=True, append_images=others, duration=lengths, loop=0)


def movie(
    runs: Sequence[Poses],
    kind: AnimationFormat,
    *,
    view: View = View.ISO,
    follow: str | None = None,
    size: tuple[float, float] = SIZE,
    dpi: int = 100,
) -> bytes:
    """Return the content of a file that Pillow (GIF) or ffmpeg (MP4) writes; see `animate`."""
    figure, axis = canvas(size)
    stage = Stage(runs, view, follow, size)
    gaps = np.diff(runs[0].time)
    per_second = runs[0].speed * float(1 / gaps[0] if gaps.size and gaps[0] else 1.0)
    stride = ceil(per_second / _FASTEST_GIF - 1e-9) if kind is AnimationFormat.GIF else 1
    writer: AbstractMovieWriter = _GifWriter(fps=per_second / stride)  # type: ignore[arg-type]
    settings: Any = {}
    if kind is AnimationFormat.MP4:
        ffmpeg = optional_module("imageio_ffmpeg", "animate")
        settings["animation.ffmpeg_path"] = ffmpeg.get_ffmpeg_exe()
        even = ["-pix_fmt", "yuv420p", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"]
        writer = FFMpegWriter(fps=per_second, codec="h264", extra_args=even)  # type: ignore[arg-type]
    with temporary_folder() as folder, matplotlib.rc_context(settings):
        place = folder / f"movie.{kind}"
        drawn, count = 0, len(runs[0].time[::stride])
        with (
            writer.saving(figure, str(place), dpi),
            doing(f"drawing {count} pictures", lambda: drawn / count),
        ):
            for drawn in range(count):
                stage.draw(axis, [drawn * stride])
                writer.grab_frame()
        return place.read_bytes()


def drawing_of(run: Trajectory, model: Dae | str | None = None) -> Drawing:
    """Return what the model of a run looks like: its own drawing, else that of a model.

    Without a model, it is the one of the catalogue that has the run's name.

    Raises:
        UsageError: The run has no drawing, and its model is not known.
    """
    if run.drawing is not None:
        return run.drawing
    if model is None:
        names = ((n, n.replace("/", "_"), n.partition("/")[0]) for n in casadi_models.CATALOG)
        model = next((same[0] for same in names if run.model in same), None)
    if model is None:
        raise UsageError(
            f"{run.model}: no model of this name has shapes to draw; name the model, "
            "with model= or --model MODEL"
        )
    dae = loaded(model) if isinstance(model, str) else model
    own = {v.name: v.start or 0.0 for v in (*dae.parameters, *dae.inputs)}
    if run.numbers is None and own:
        warn(
            f"{run.model}: the run does not know its parameters; it is drawn with those of "
            f"{dae.full_name}: set others with dataclasses.replace(run, numbers={{...}}) or -p",
            stacklevel=3,
        )
    return dae.drawing.with_numbers({**own, **(run.numbers or {})})


def guessed_model(paths: Sequence[str]) -> str:
    """Return the model of the catalogue whose bodies and loads the columns of CSV files place."""
    names = set()
    for path in paths:
        try:
            with Path(path).open(encoding="utf-8") as stream:
                names |= set(stream.readline().strip().split(","))
        except (OSError, ValueError) as error:
            raise UsageError(f"{path} is no result of a run: {error}") from error
    fitting = []
    for model in dict.fromkeys(entry.partition("/")[0] for entry in casadi_models.CATALOG):
        dae = loaded(model)
        known = names | {v.name for v in (*dae.parameters, *dae.inputs)}
        drawing = dae.drawing
        used = [expression for b in drawing.bodies for expression in (b.place, ca.vec(b.rotation))]
        used += [expression for a in drawing.arrows for expression in (a.at, a.vector)]
        if {symbol.name() for symbol in ca.symvar(ca.vertcat(*used))} <= known:
            fitting.append(model)
    if len(fitting) != 1:
        found = " and ".join(fitting) or "no model"
        raise UsageError(f"{', '.join(paths)}: the columns fit {found}; give --model MODEL")
    return fitting[0]


_SLIDERS = {Role.INPUT: "input", Role.PARAMETER: "parameter", Role.STATE: "start"}


def live_part(dae: Dae, run: Trajectory) -> dict[str, Any]:
    """Return what a page needs to compute runs of a model, at the output times of a run.

    Args:
        dae: The model; its own values are where the sliders begin.
        run: A run of it; its variables are those that the page can show.

    Raises:
        MissingTool: ziglang is not installed, or it fails.
        UsageError: The run holds variables that the model's FMU lacks.
    """
    plan = planned(dae, FmuOptions())
    files = files_of(plan)
    sources = {Path(p).name: c for p, c in files.items() if p.startswith("sources/")}
    variables = _variables(plan)
    for name in run.names:
        if name not in variables:
            raise UsageError(f"{dae.full_name}: '{name}' is no variable of its FMU; record others")
    drawing = dae.drawing or POINT
    shapes, picture = _picture(drawing)
    symbols = {s.name(): s for s in ca.symvar(picture)}
    time = symbols.pop("time", SX.sym("time"))
    own = [name for name in symbols if name in variables]
    constants = [name for name in symbols if name not in variables]
    numbers = [SX(drawing.numbers[name]) for name in constants]
    [picture] = ca.substitute([picture], [symbols[name] for name in constants], numbers)
    values = ca.vertcat(*(symbols[name] for name in own), SX.sym("curves", len(run.names)))
    drawn = ca.Function("drawn", [values, time], [picture], {"cse": True})
    sources["drawing.c"] = generated("drawing", drawn).encode()
    sources["page.c"] = source_text("page/page.c").encode()
    references = [variables[name]["reference"] for name in (*own, *run.names)]
    _start_settings(dae, run, variables)
    starts = sorted(variables.values(), key=lambda v: "through" not in v)  # a speed before a rate
    return {
        "program": packed(compiled_library(sources, "page", WEB_PAGE)),
        "settings": [v for v in starts if "value" in v],
        "references": references,
        "first": len(own),
        "times": run.time.tolist(),
        "width": len(references) + picture.numel(),
        "shapes": shapes,
    }


def _start_settings(dae: Dae, run: Trajectory, variables: dict[str, dict[str, Any]]) -> None:
    """Note which settings are start values, besides the states themselves.

    Some outputs give the start value of a state, e.g. a speed that of a wheel's rate; and some
    parameters are used for nothing else than start values.
    """
    used = {s.name() for s in ca.symvar(ca.vertcat(dae.ode, dae.alg, dae.outputs))}
    later = [expression for expression, _ in dae.limits]
    later += [part for event in dae.events for part in (event.condition, event.values)]
    used |= {s.name() for expression in later for s in ca.symvar(expression)}
    for rule in dae.start_rules:
        for symbol in ca.symvar(rule.expression):
            if symbol.name() not in used and "value" in (facts := variables.get(symbol.name(), {})):
                facts["kind"] = "start"
    names = list(run.names)
    for way in dae.start_outputs:
        output, state = way.variable.name, dae.states[way.state].name
        if output in names and state in names and "value" in variables[state]:
            variables[state]["column"] = names.index(state)
            value = float(run[output][0])
            reach = abs(value) or way.variable.nominal
            variables[output] |= {"kind": "start", "value": value, "through": state}
            variables[output] |= {"low": value - reach, "high": value + reach}
            variables[output]["column"] = names.index(output)


def _picture(drawing: Drawing) -> tuple[int, SX]:
    """Return how many numbers describe the shapes, and all numbers of a row for scene.js."""
    shapes = [ca.vertcat(ca.vec(s.size), s.at, s.along) for s in drawing.shapes]
    arrows = [ca.vertcat(a.at, a.vector) for a in drawing.arrows]
    points = [trace.at for trace in drawing.traces]
    picture = ca.densify(ca.vertcat(motion(drawing), *arrows, *points, *shapes))
    return sum(shape.numel() for shape in shapes), picture


def _variables(plan: Plan) -> dict[str, dict[str, Any]]:
    """Return what a page knows of an FMU's variables; those with a `value` can be set."""
    found = {}
    for reference, v in enumerate(plan.variables):
        facts = column_facts(Column(v.name, v.unit, v.display_unit, meaning=v.meaning))
        found[v.name] = facts | {"reference": reference}
        if v.role is Role.INPUT or v.start_kind is Start.EXACT:
            value = v.start or 0.0
            low, high = _range(value, v)
            found[v.name] |= {"kind": _SLIDERS[v.role], "value": value, "low": low, "high": high}
    return found


def _range(value: float, variable: FmuVariable) -> tuple[float, float]:
    """Return the ends of a slider: up to twice the value, or the nominal value to both sides.

    An angle goes around once at most.
    """
    least, most = meant_bounds(variable)
    reach = abs(value) or variable.nominal
    if variable.unit == "rad":
        reach = min(max(reach, radians(60)), pi)
    low = 0.1 * value if least >= 0 < value else value - reach
    return max(least, low), min(most, value + reach)
