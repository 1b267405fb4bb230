"""Derivatives of a run over time, a panel for each output, the heaviest ones named."""

import numpy as np
from matplotlib.figure import Figure

from cosim.study.sensitivity.result import Sensitivity

MOST_PANELS, MOST_CURVES = 8, 6


def draw_sensitivity(found: Sensitivity) -> Figure:
    """Draw scaled derivatives: nominal values of the output per whole size of the target."""
    names = found.run.names[:MOST_PANELS]
    figure = Figure(figsize=(7.5, 1.0 + 1.9 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False).ravel()
    scaled = found.scaled
    heaviest = np.argsort(-np.abs(scaled).max(axis=(0, 1)), kind="stable")
    colours = {int(j): f"C{place % 10}" for place, j in enumerate(heaviest)}  # in every panel
    for i, (axis, name) in enumerate(zip(axes, names, strict=True)):
        weights = np.abs(scaled[:, i, :]).max(axis=0)
        order = np.argsort(-weights, kind="stable")
        for rank, j in enumerate(order):
            named = rank < MOST_CURVES and weights[j] > 0
            axis.plot(
                found.run.time,
                scaled[:, i, j],
                color=colours[int(j)] if named else "0.85",
                linewidth=1.1 if named else 0.6,
                label=found.targets[j].name if named else None,
                zorder=3 if named else 1,
            )
        axis.set_ylabel(name)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
        axis.grid(visible=True, alpha=0.3)
    axes[-1].set_xlabel("time [s]")
    figure.suptitle(f"{found.run.model}: derivatives, scaled", fontsize=10)
    return figure
