"""Moving pictures: GIF through Pillow, MP4 through ffmpeg."""

from collections.abc import Sequence
from math import isclose
from typing import Any

import matplotlib
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter

from cosim.host.optional_packages import optional_module
from cosim.host.temporary import temporary_folder
from cosim.present.playback.playback import Playback
from cosim.present.playback.render import Stage, canvas

MOVIE_RATES = {"gif": 15.0, "mp4": 25.0}
_DPI = 100
_SIZE = (6.4, 4.8)  # inches


def movie(
    runs: Sequence[Playback],
    kind: str,
    *,
    view: str = "iso",
    follow: str | None = None,
    speed: float = 1.0,
    size: tuple[float, float] = _SIZE,
    dpi: int = _DPI,
) -> bytes:
    """Return the content of a GIF or MP4 file.

    Args:
        runs: With the same frames; the first in full colour, the others as pale ghosts.
        kind: "gif" or "mp4".
        view, follow, size: See `draw_pose`.
        speed: Seconds of the run in a second of playback.
        dpi: Dots per inch.

    Raises:
        MissingTool: imageio-ffmpeg is not installed; only MP4 needs it.
    """
    figure, axis = canvas(size)
    stage = Stage(runs, view, follow, size)
    per_second = _rate(runs[0]) * speed
    writer: AbstractMovieWriter = PillowWriter(fps=per_second)  # type: ignore[arg-type]
    settings: Any = {}
    if kind == "mp4":
        ffmpeg = optional_module("imageio_ffmpeg", "animate")
        settings["animation.ffmpeg_path"] = ffmpeg.get_ffmpeg_exe()
        even = ["-pix_fmt", "yuv420p", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"]
        writer = FFMpegWriter(fps=per_second, codec="h264", extra_args=even)  # type: ignore[arg-type]
    with temporary_folder() as folder, matplotlib.rc_context(settings):
        place = folder / f"movie.{kind}"
        with writer.saving(figure, str(place), dpi):
            for frame in range(len(runs[0].time)):
                stage.draw(axis, [frame])
                writer.grab_frame()
        return place.read_bytes()


def _rate(run: Playback) -> float:
    """Return how many frames there are in a second of the run."""
    gaps = np.diff(run.time)
    if not len(gaps) or isclose(gaps[0], 0.0):
        return 1.0
    return float(1 / gaps[0])
