"""Figures to files, whole or not at all, and to windows."""

import io
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from cosim.errors import UnknownName, UsageError
from cosim.files import write_atomically
from cosim.plotting import DPI, UNDATED, picture

FORMATS = ("png", "svg", "pdf")
_WITHOUT_SCREEN = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")  # backends


def picture_format(target: str) -> str:
    """Return the format that the ending of a file name stands for.

    Raises:
        UnknownName: It is none of `FORMATS`.
    """
    kind = Path(target).suffix.lstrip(".").lower()
    if kind not in FORMATS:
        raise UnknownName.among(target, "picture format", kind, FORMATS)
    return kind


def save(figures: Sequence[Figure], target: str, dpi: int = DPI) -> list[Path]:
    """Write figures as PNG, SVG or PDF, by the ending of the name; same figures, same bytes.

    Args:
        figures: One or more.
        target: File name. Several figures become the pages of one PDF, or NAME-01, NAME-02, ...
        dpi: Dots per inch of a PNG.

    Returns:
        The files that were written.

    Raises:
        UnknownName: The ending is another one.
        ExportError: A file cannot be written.
    """
    kind, path = picture_format(target), Path(target)
    if kind == "pdf":
        return [write_atomically(path, _pages(figures))]
    digits = max(2, len(str(len(figures))))
    names = [path.with_stem(f"{path.stem}-{i:0{digits}}") for i in range(1, len(figures) + 1)]
    contents = [picture(figure, kind, dpi) for figure in figures]
    places = names if len(figures) > 1 else [path]
    return [write_atomically(place, content)
            for place, content in zip(places, contents, strict=True)]  # fmt: skip


def require_screen() -> None:
    """Refuse to draw windows where there is no screen for them.

    Raises:
        UsageError: matplotlib only draws files here.
    """
    import matplotlib.pyplot as plt

    if plt.get_backend().lower() in _WITHOUT_SCREEN:
        raise UsageError("there is no screen for a window; name a file with --output-file FILE.png")


def show(figures: Sequence[Figure]) -> None:
    """Show every figure in a window of its own until all are closed."""
    import matplotlib.pyplot as plt

    for figure in figures:
        window = plt.figure(figsize=figure.get_size_inches())
        manager = window.canvas.manager
        if manager is not None:
            figure.set_canvas(manager.canvas)
            manager.canvas.figure = figure
    plt.show()


def _pages(figures: Sequence[Figure]) -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages  # takes longer than a PNG to draw

    content = io.BytesIO()
    with PdfPages(content, metadata=UNDATED["pdf"]) as pdf:
        for figure in figures:
            pdf.savefig(figure)
    return content.getvalue()
