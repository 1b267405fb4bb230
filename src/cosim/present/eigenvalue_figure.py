"""Eigenvalues against a parameter, with the values at which one crosses the imaginary axis."""

from matplotlib.figure import Figure

from cosim.study.linearize.sweep import EigenvalueSweep

_NOTHING = 1e-9  # of the largest: an imaginary part, or an eigenvalue, that is none


def draw_eigenvalues(sweep: EigenvalueSweep) -> Figure:
    """Draw real parts as lines and imaginary parts as dashes; what stays zero is left out."""
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    axis = figure.subplots()
    size = float(abs(sweep.eigenvalues).max()) or 1.0
    for j, column in enumerate(sweep.eigenvalues.T):
        if abs(column).max() <= _NOTHING * size:
            continue
        colour = f"C{j % 10}"
        axis.plot(sweep.values, column.real, color=colour, linewidth=1.2)
        imaginary = abs(column.imag)
        if imaginary.max() > _NOTHING * size:
            axis.plot(sweep.values, imaginary, "--", color=colour, linewidth=0.8)
    axis.axhline(0.0, color="black", linewidth=0.6)
    for crossing in sweep.crossings:
        axis.axvline(crossing.value, color="0.5", linewidth=0.8)
        kind = "oscillates" if crossing.frequency else "real"
        axis.annotate(
            f"{crossing.value:.6g}, {kind}",
            (crossing.value, 0.02),
            xycoords=("data", "axes fraction"),
            rotation=90,
            ha="right",
            va="bottom",
            fontsize=7,
            color="0.3",
        )
    unit = f" [{sweep.unit}]" if sweep.unit else ""
    axis.set_xlabel(f"{sweep.name}{unit}")
    axis.set_ylabel("eigenvalue [1/s]: real part, imaginary part dashed")
    axis.set_title(sweep.points[0].model, fontsize=10)
    return figure
