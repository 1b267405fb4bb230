"""Curves drawn by matplotlib, and picture files."""

import io
from base64 import b64encode
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.cbook import is_math_text
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text

from cosim.arrays import Vector
from cosim.colors import INVALID
from cosim.errors import UnknownName, UsageError
from cosim.files import write_atomically

DPI, MOST_PIXELS = 120, 4e8
_LETTERS = 7  # points; the smallest ones
LINES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (3, 1, 1, 1)), (0, (1, 1)), "-.", "--")  # for print
STYLE: Any = matplotlib.rc_params_from_file(  # matplotlib types its keys one by one
    Path(__file__).with_name("cosim.mplstyle"), use_default_template=False
)
UNDATED = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}


class Picture(Figure):
    """A figure that a notebook shows by itself.

    A model's text between dollar signs that is no formula is drawn as it is written.
    """

    def draw(self, renderer: RendererBase) -> None:
        """Draw the figure."""
        for text in self.findobj(Text):
            assert isinstance(text, Text)
            if _wrong_formula(text.get_text()):
                text.set_parse_math(False)
        super().draw(renderer)

    def _repr_png_(self) -> bytes:
        return picture(self, "png")


def shade_invalid(axis: Axes, time: Vector, invalid_from: float) -> None:
    """Shade the span of a time axis in which a run is outside its validity range."""
    if not len(time) or invalid_from > time[-1]:
        return
    end = max(float(time[-1]), invalid_from)
    axis.axvspan(invalid_from, end, color=INVALID, alpha=0.12, linewidth=0, zorder=0)
    axis.axvline(invalid_from, color=INVALID, linewidth=0.8, zorder=1)
    drawn = (np.array(line.get_data(), dtype=float) for line in axis.get_lines())
    curves = [data for data in drawn if data.shape[1] > 2]  # no marks of instants
    points = np.hstack([np.empty((2, 0)), *curves])
    valid = points[1, (points[0] < invalid_from) & np.isfinite(points[1])]
    if valid.size and (span := float(np.ptp(valid))):  # what is invalid may be of any size
        low, high = axis.get_ylim()
        axis.set_ylim(max(low, valid.min() - 0.5 * span), min(high, valid.max() + 0.5 * span))


def keep_constant_flat(axis: Axes, values: Vector, nominal: float) -> None:
    """Widen the range around constant curves, whose numerical errors would fill the panel.

    A text says how large values are that look like 0. Values, (n,) or (n, curves), and the nominal
    value have the unit of the vertical axis; values that are not finite do not count.
    """
    values = values[np.isfinite(values)]
    if values.size and np.ptp(values) < max(1e-9 * nominal, 1e-6 * float(np.abs(values).max())):
        middle, most = float(values[0]), float(np.abs(values).max())
        looks_zero = abs(middle) <= 1e-9 * nominal
        margin = nominal if looks_zero else 0.1 * abs(middle)
        axis.set_ylim(middle - margin, middle + margin)
        if looks_zero and most:
            text = f"at most {most:.1e}"
            axis.text(0.98, 0.96, text, transform=axis.transAxes, ha="right", va="top", fontsize=8)


def embedded(figure: Figure, alt: str) -> str:
    """Return a figure as HTML with the picture inside."""
    content = b64encode(picture(figure, "png", dpi=60)).decode()
    return f'<img alt="{alt}" src="data:image/png;base64,{content}"/>'


def picture(figure: Figure, kind: str, dpi: int = DPI) -> bytes:
    """Return the content of a picture file; the same figure gives the same bytes."""
    width, height = figure.get_size_inches()
    reject_pixels(width, height, dpi if kind == "png" else DPI)
    content = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "cosim"}):
        figure.savefig(content, format=kind, dpi=dpi, metadata=UNDATED[kind])
    return content.getvalue()


def reject_pixels(width: float, height: float, dpi: float) -> None:
    """Reject the size of a picture, inches, with letters below a pixel, or too many pixels."""
    across, down = width * dpi, height * dpi
    if not (min(across, down) >= 1 and across * down <= MOST_PIXELS):
        size = f"{across:.4g} x {down:.4g}"
        raise UsageError(f"a picture cannot have {size} pixels; change its size or dpi")
    if dpi * _LETTERS < 72:
        raise UsageError(f"at {dpi:g} dpi, letters are smaller than a pixel; give a larger dpi")


def reject_formulas(texts: Iterable[str]) -> None:
    """Reject texts with a formula that matplotlib cannot read, whether they are drawn or not.

    Raises:
        UsageError: One of them has such a formula.
    """
    for formula in filter(None, map(_wrong_formula, texts)):
        raise UsageError(
            f"a text of the figure has the formula '{formula}', which matplotlib cannot read; "
            "correct it, or write \\$ for a dollar sign"
        )


def _wrong_formula(text: str) -> str:
    """Return the part of a text between dollar signs that matplotlib cannot read as a formula."""
    if is_math_text(text):
        try:
            MathTextParser("path").parse(text)
        except ValueError as error:
            return str(error).strip().splitlines()[0]
    return ""


FORMATS = ("png", "svg", "pdf")
_WITHOUT_SCREEN = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")  # backends


def picture_format(target: str) -> str:
    """Return the format of a picture file by the ending of its name.

    Raises:
        UnknownName: The ending is none of `FORMATS`.
    """
    kind = Path(target).suffix.lstrip(".").lower()
    UnknownName.reject(target, "picture format", FORMATS, kind)
    return kind


def save(figures: Sequence[Figure], target: str, dpi: int = DPI) -> list[Path]:
    """Write figures as PNG, SVG or PDF, by the ending of the file name.

    The same figures give the same bytes.

    Args:
        figures: One or more.
        target: File name. Several figures become the pages of one PDF, or NAME-01, NAME-02, ...
        dpi: Dots per inch of a PNG.

    Returns:
        The files that were written.

    Raises:
        UnknownName: The file name has another ending.
        ExportError: A file cannot be written.
    """
    kind, path = picture_format(target), Path(target)
    if kind == "pdf":
        return [write_atomically(path, _pages(figures))]
    contents = [picture(figure, kind, dpi) for figure in figures]
    if len(contents) == 1:
        return [write_atomically(path, contents[0])]
    digits = max(2, len(str(len(figures))))
    return [
        write_atomically(path.with_stem(f"{path.stem}-{i:0{digits}}"), content)
        for i, content in enumerate(contents, start=1)
    ]


def require_screen() -> None:
    """Check that matplotlib can open windows.

    Raises:
        UsageError: It can write files only.
    """
    import matplotlib.pyplot as plt

    if plt.get_backend().lower() in _WITHOUT_SCREEN:
        raise UsageError("there is no screen for a window; name a file with --output-file FILE.png")


def show(figures: Sequence[Figure]) -> None:
    """Show every figure in its own window until all windows are closed."""
    import matplotlib.pyplot as plt

    for figure in figures:
        window = plt.figure(figsize=figure.get_size_inches())
        manager = window.canvas.manager
        if manager is not None:
            figure.set_canvas(manager.canvas)
            manager.canvas.figure = figure
    plt.show()


def _pages(figures: Sequence[Figure]) -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages  # loads slowly

    content = io.BytesIO()
    with PdfPages(content, metadata=UNDATED["pdf"]) as pdf:
        for figure in figures:
            pdf.savefig(figure)
    return content.getvalue()
