"""`animate`: a run, or several, in three dimensions, to a file or into a notebook."""

import html as html_module
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from warnings import warn

import casadi as ca

import casadi_models
from casadi_models.dae import Dae, Drawing
from cosim.errors import UnknownName, UsageError
from cosim.files import write_atomically
from cosim.model.catalogue import load
from cosim.plotting import picture
from cosim.present.playback import movie
from cosim.present.playback.glb import glb
from cosim.present.playback.html import html
from cosim.present.playback.playback import FRAMES_PER_SECOND, Playback, playback
from cosim.present.playback.render import draw_pose
from cosim.present.scale import VIEWS
from cosim.trajectory import Trajectory

ANIMATION_FORMATS = ("html", "glb", "mp4", "gif", "png", "svg", "pdf")
_STILL = ("png", "svg", "pdf")


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
    runs: Trajectory | Sequence[Trajectory],
    target: str | os.PathLike[str] | None = None,
    *,
    model: Dae | str | None = None,
    values: Mapping[str, float] | None = None,
    at: Sequence[float] | None = None,
    labels: Sequence[str] = (),
    view: str = "iso",
    follow: str | None = None,
    speed: float = 1.0,
    size: tuple[float, float] = (6.4, 4.8),
    dpi: int = 120,
) -> Path | Animation:
    """Show runs in three dimensions.

    Args:
        runs: One run, or several of one scene: the others are ghosts.
        target: File that ends with .html, .glb, .mp4, .gif, .png, .svg or .pdf; none for an
            object that a notebook shows.
        model: Whose shapes are drawn, for a run that does not know its model (of an FMU, or read
            from a file): a Dae or a name that `load` takes.
        values: Parameters of that run, SI, where it does not know them (one read from a file).
        at: Times of the poses of a still picture, s; the start when None. Earlier ones are pale.
        labels: Variables to write beside the picture, in display units.
        view: Where the camera is at first: "iso", "front", "side" or "top".
        follow: Body that stays in the middle; the model's own when None, "" for a camera at rest.
        speed: Seconds of the run in a second of playback.
        size: Of pictures and movies, inches.
        dpi: Dots per inch of pictures and movies.

    Returns:
        The file, or the object.

    Raises:
        UsageError: The model declares no shapes, or is not known; the run lacks what they need.
        UnknownName: The file's ending, the view or a label is not known.
        MissingTool: An extra package is not installed.
        ExportError: The file cannot be written.

    Example:
        >>> import cosim
        >>> animate(cosim.simulate("crank_shaft", stop_time=0.1), "crank.png").name
        'crank.png'
    """
    shown = [runs] if isinstance(runs, Trajectory) else list(runs)
    if not shown or not all(isinstance(run, Trajectory) for run in shown):
        raise UsageError.of_type("animate", runs, "results of simulate or simulate_fmu")
    kind = "html" if target is None else animation_format(target)
    if view not in VIEWS:
        raise UnknownName.among("animate", "view", view, VIEWS)
    if not speed > 0:
        raise UsageError(f"animate: speed {speed:g} is not positive")
    if at is not None and kind not in _STILL:
        raise UsageError(f"animate: poses at given times make a picture; name a .png, not .{kind}")
    per_second = movie.MOVIE_RATES.get(kind, FRAMES_PER_SECOND)
    first = shown[0]
    times = still_times(first, at) if kind in _STILL else None
    played: list[Playback] = []
    for run in shown:
        drawing = drawing_of(run, model, values)
        if played:
            times = [min(max(t, run.time[0]), run.time[-1]) for t in played[0].time.tolist()]
        rate = {"frames_per_second": per_second, "speed": speed}
        wanted = () if played else labels
        played.append(playback(run, drawing, times=times, labels=wanted, **rate))
        for note in played[-1].notes:
            warn(f"{run.model}: {note}", stacklevel=2)
    if kind in _STILL:
        poses = range(len(played[0].time))
        still = draw_pose(played, poses, view=view, follow=follow or "", size=size)
        content = picture(still, kind, dpi)
    elif kind == "html":
        page = Animation(html(played, view=view, follow=follow, speed=speed))
        if target is None:
            return page
        content = page.page.encode()
    elif kind == "glb":
        content = glb(played, follow=follow, speed=speed)
    else:
        look: Any = {"view": view, "follow": follow, "speed": speed, "size": size, "dpi": dpi}
        content = movie.movie(played, kind, **look)
    assert target is not None
    return write_atomically(target, content)


def animation_format(target: str | os.PathLike[str]) -> str:
    """Return the format that the ending of a file name stands for.

    Raises:
        UnknownName: It is none of `FORMATS`.
    """
    kind = Path(target).suffix.lstrip(".").lower()
    if kind not in ANIMATION_FORMATS:
        raise UnknownName.among(str(target), "animation format", kind, ANIMATION_FORMATS)
    return kind


def drawing_of(
    run: Trajectory, model: Dae | str | None = None, values: Mapping[str, float] | None = None
) -> Drawing:
    """Return what the model of a run looks like.

    Raises:
        UsageError: Nobody knows the model.
    """
    if run.drawing is not None:
        return run.drawing
    if model is None:
        model = next((n for n in casadi_models.CATALOG if n.replace("/", "_") == run.model), None)
        if any(run.model in (entry, entry.partition("/")[0]) for entry in casadi_models.CATALOG):
            model = model or run.model
    if model is None:
        raise UsageError(
            f"{run.model}: nobody knows what this model looks like; name one that does, "
            "with model= or --model MODEL"
        )
    dae = load(model) if isinstance(model, str) else model
    own = {v.name: v.start or 0.0 for v in (*dae.parameters, *dae.inputs)}
    if values is None and run.numbers is None and own:
        warn(
            f"{run.model}: the run does not know its parameters; it is drawn with those of "
            f"{dae.full_name}: give others by values= or -p",
            stacklevel=3,
        )
    return dae.drawing.with_numbers({**own, **(run.numbers or {}), **(values or {})})


def guessed_model(paths: Sequence[str]) -> str:
    """Return the model of the catalogue whose bodies and loads CSV results describe.

    Raises:
        UsageError: There is none, or more than one.
    """
    names = set()
    for path in paths:
        try:
            with Path(path).open(encoding="utf-8") as stream:
                names |= set(stream.readline().strip().split(","))
        except (OSError, ValueError) as error:
            raise UsageError(f"{path} is no result of a run: {error}") from error
    fitting = []
    for model in dict.fromkeys(entry.partition("/")[0] for entry in casadi_models.CATALOG):
        dae = load(model)
        known = names | {v.name for v in (*dae.parameters, *dae.inputs)}
        drawing = dae.drawing
        used = [expression for b in drawing.bodies for expression in (b.place, ca.vec(b.rotation))]
        used += [expression for a in drawing.arrows for expression in (a.at, a.vector)]
        if {symbol.name() for symbol in ca.symvar(ca.vertcat(*used))} <= known:
            fitting.append(model)
    if len(fitting) != 1:
        found = " and ".join(fitting) or "no model"
        raise UsageError(f"{', '.join(paths)}: {found} could be drawn so; give --model MODEL")
    return fitting[0]


def still_times(run: Trajectory, at: Sequence[float] | None) -> list[float]:
    """Return the times of the poses of a still picture, s."""
    if at is not None:
        return [float(time) for time in at]
    return [float(run.time[0])] if len(run) else []
