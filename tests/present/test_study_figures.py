"""Figures of studies: what a reader must find in them."""

from dataclasses import replace

import numpy as np
import pytest

import cosim
from cosim.present.study_figures import draw_eigenvalues, draw_sensitivity


@pytest.fixture(scope="module")
def sweep():
    speeds = np.linspace(-10, -24, 15).tolist()
    return cosim.linearize(
        "bicycle", along={"thetaR_dot": speeds}, start_values={"phi_dot": 0.0}, outputs=["speed"]
    )


def crossings(figure):
    (top,) = figure.axes[0].child_axes
    return [text.get_text() for text in top.get_xticklabels()]


def test_eigenvalues_name_modes_the_stable_band_and_critical_speeds_with_units(sweep):
    figure = draw_eigenvalues(sweep)
    axis = figure.axes[0]
    names = {text.get_text() for text in figure.legends[0].get_texts()}
    assert names == {"castering", "capsize", "weave", "real part", "imaginary part", "stable"}
    assert axis.get_xlabel() == "thetaR_dot [rad/s]"
    assert axis.get_ylabel() == "eigenvalue [1/s]"
    assert crossings(figure) == [
        "capsize\n-20.08 rad/s\nspeed 6.024 m/s", "weave\n-14.31 rad/s\nspeed 4.292 m/s",
    ]  # fmt: skip


def test_texts_of_close_crossings_stand_at_different_heights(sweep):
    first = sweep.crossings[0]
    several = [replace(first, value=first.value + k) for k in range(3)]
    lines = [
        text.count("\n") for text in crossings(draw_eigenvalues(replace(sweep, crossings=several)))
    ]
    assert lines == [2, 5, 2]


@pytest.mark.slow
def test_modes_and_sensitivities_differ_without_color(sweep):
    curves = [line for line in draw_eigenvalues(sweep).axes[0].lines if len(line.get_xdata()) > 2]
    assert len({line.get_marker() for line in curves}) == 3
    found = cosim.sensitivity(
        "bicycle",
        outputs=["phi"],
        with_respect_to=["mB", "c", "phi_dot"],
        stop_time=0.2,
        check=False,
    )
    axis = draw_sensitivity(found).axes[0]
    assert len({str(line.get_linestyle()) + str(line._dash_pattern) for line in axis.lines}) == 3
    assert axis.get_ylabel() == "change of phi\n[nominal values]"
