"""Pictures that cannot mislead: what is invalid, missing, zero or long is seen to be so."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from helpers.scenes import spinning
from matplotlib.collections import PolyCollection

import cosim
from cosim.cli.main import main
from cosim.cli.verbs.plot import overview
from cosim.present.figures import draw_figures, draw_overlay, run_labels, shared_specs
from cosim.scene.scene import FigureSpec
from cosim.trajectory import Trajectory


@pytest.fixture(scope="module")
def invalid():
    return cosim.simulate(spinning(4.0, limit=2.0), stop_time=1.0, compiled=False)


def spans(axis):
    """Return the shaded spans of a time axis."""
    found = []
    for patch in axis.patches:
        box = patch.get_extents().transformed(axis.transData.inverted())
        found.append((box.x0, box.x1))
    return found


def words(figure):
    texts = [figure.get_suptitle(), figure.get_supxlabel()]
    texts += [legend.get_title().get_text() for legend in figure.legends]
    for axis in figure.axes:
        texts += [
            axis.get_title(),
            axis.get_title(loc="right"),
            *(t.get_text() for t in axis.texts),
        ]
    return " ".join(" ".join(texts).split())


def boxes(figure):
    """Return the places of all axis labels of a figure, in dots."""
    figure.canvas.draw()
    labels = [label for a in figure.axes for label in (a.xaxis.label, a.yaxis.label, a.title)]
    return [label.get_window_extent() for label in labels if label.get_text()]


def test_overview_draws_every_variable():
    run = cosim.simulate(cosim.load("double_pendulum"), stop_time=0.1, compiled=False)
    figure = run.plot()
    drawn = {axis.get_ylabel().partition(" ")[0] for axis in figure.axes if axis.get_visible()}
    assert drawn == set(run.names)
    assert {"y_tip", "z_tip", "energy"} <= drawn
    pages = overview(run)
    on_pages = [axis.get_ylabel().partition(" ")[0] for page in pages for axis in page.axes
                if axis.get_visible()]  # fmt: skip
    assert on_pages == list(run.names)
    assert "page 2 of 2" in pages[1].get_suptitle()


def test_invalid_span_is_shaded_and_named_in_the_overview(invalid):
    figure = invalid.plot()
    for axis in figure.axes[: len(invalid.names)]:
        assert spans(axis)[0] == pytest.approx((0.5, 1.0))
    assert "invalid from 0.5 s: not fulfilled: the disk turns" in words(figure)


def test_invalid_span_is_shaded_in_a_scenes_figure_and_in_an_overlay(invalid):
    spec = FigureSpec("Angle", (("angle",),))
    other = cosim.simulate(spinning(1.0, limit=2.0), stop_time=1.0, compiled=False)
    for figure in (
        *draw_figures([spec], invalid),
        *draw_figures([spec], invalid, other),
        *draw_overlay([spec], [invalid, other]),
    ):
        assert spans(figure.axes[0])[0] == pytest.approx((0.5, 1.0))
        assert "invalid from 0.5 s" in words(figure)
        assert "the disk turns by less than 2 rad" in words(figure)


def test_valid_run_has_no_shade():
    run = cosim.simulate(spinning(1.0), stop_time=1.0, compiled=False)
    assert not spans(run.plot().axes[0])
    assert "INVALID" not in words(run.plot())


def test_invalid_part_of_a_path_is_marked(invalid):
    spec = FigureSpec("Path", (("angle",),), x="angle")
    lines = draw_figures([spec], invalid)[0].axes[0].lines
    bad = lines[-1].get_xdata()
    assert bad[0] == pytest.approx(np.degrees(2.0))


@pytest.mark.parametrize("letters", [20, 200, 800])
def test_titles_fit_whatever_the_failure_says(letters):
    run = cosim.simulate(spinning(1.0), stop_time=0.5, compiled=False)
    told = ("stopped after 0.4 s: " + "it went wrong in a way " * 40)[:letters]
    figure = replace(run, status=told).plot()
    figure.canvas.draw()
    width, height = figure.get_size_inches() * figure.dpi
    for text in (figure._suptitle, figure._supxlabel):
        box = text.get_window_extent()
        assert box.x0 >= 0
        assert box.x1 <= width
        assert box.y0 >= 0
        assert box.y1 <= height


def test_difference_that_is_zero_is_drawn_as_zero():
    run = cosim.simulate(spinning(1.0), stop_time=0.5, compiled=False)
    spec = FigureSpec("Angle", (("angle",),))
    lower = draw_figures([spec], run, run)[0].axes[1]
    assert lower.get_yticks().tolist() == [0.0]
    assert "exactly zero" in [text.get_text() for text in lower.texts]


@pytest.mark.parametrize("other", [False, True])
def test_labels_do_not_overlap(other):
    names = ("angle", "angle", "angle")
    run = cosim.simulate(spinning(1.0), stop_time=0.5, compiled=False)
    labels = ("Angular momentum of everything about O", "Energy", "A very long name of an angle")
    spec = FigureSpec("Conserved", tuple((n,) for n in names), labels=labels)
    second = cosim.simulate(spinning(1.1), stop_time=0.5, compiled=False) if other else None
    found = boxes(draw_figures([spec], run, second)[0])
    for one, two in combinations(found, 2):
        assert not one.overlaps(two)


def test_runs_are_told_apart_without_color(invalid):
    others = [cosim.simulate(spinning(r), stop_time=1.0, compiled=False) for r in (1.0, 2.0, 3.0)]
    figure = draw_overlay([FigureSpec("Angle", (("angle",),))], others)[0]
    assert (
        len({line.get_linestyle() + str(line._dash_pattern) for line in figure.axes[0].lines}) == 3
    )
    several = FigureSpec("Two", (("angle", "twice"),))
    table = Trajectory("x", invalid.time, (replace(invalid.columns[0], name="angle"),
                       replace(invalid.columns[0], name="twice")),
                       np.column_stack([invalid["angle"]] * 2))  # fmt: skip
    lines = draw_figures([several], table)[0].axes[0].lines
    assert lines[0].get_linestyle() != lines[1].get_linestyle()


def test_runs_are_called_by_what_differs():
    run = cosim.simulate(spinning(1.0), stop_time=0.1, compiled=False)
    named = [replace(run, stats={**run.stats, "variation": f"rate={i}"}) for i in (1, 2)]
    assert run_labels(named) == ["rate=1", "rate=2"]
    assert run_labels([run, run]) == ["spinning (1)", "spinning (2)"]


def test_what_one_run_lacks_is_named():
    run = cosim.simulate(cosim.load("crank_shaft"), stop_time=0.1, compiled=False)
    less = run.select(["phi", "omega"])
    specs = (FigureSpec("Spin", (("phi",), ("T",))), FigureSpec("Force", (("fx_A",),)))
    kept, notes = shared_specs(specs, [run, less])
    assert [spec.panels for spec in kept] == [(("phi",),)]
    assert notes == ("not drawn, as not every run has it: T, fx_A",)


@pytest.mark.slow
def test_formulations_with_other_outputs_are_compared_as_far_as_they_go(tmp_path, capsys):
    target = tmp_path / "x.pdf"
    words = ("double_pendulum_7_2.toml", "--compare", "multipliers", "--stop-time", "0.2")
    assert main(["plot", *words, "-o", str(target)]) == 0
    assert "not drawn, as not every run has it: psi1, theta1" in capsys.readouterr().err


@pytest.mark.slow
def test_scenes_results_and_fmus_overlay(tmp_path):
    fmu, table, target = tmp_path / "c.fmu", tmp_path / "c.csv", tmp_path / "x.png"
    assert main(["export", "crank_shaft", "-o", str(fmu), "-q"]) == 0
    assert main(["simulate", "crank_shaft", "--stop-time", "1", "-o", str(table)]) == 0
    sources = ("crank_torque.toml", str(table), str(fmu))
    assert main(["plot", *sources, "-q", "-o", str(target)]) == 0
    assert target.stat().st_size > 10_000


def test_size_and_dots_of_a_picture_are_chosen(tmp_path):
    from PIL import Image

    target = tmp_path / "x.png"
    look = ("--size", "5x4", "--dpi", "50")
    assert main(["plot", "crank_torque.toml", "-q", "-o", str(target), *look]) == 0
    with Image.open(target) as picture:
        assert picture.size == (250, 200)


def test_notebook_shows_figures_without_magic(invalid):
    spec = FigureSpec("Angle", (("angle",),))
    for figure in (invalid.plot(), *draw_figures([spec], invalid),
                   *draw_overlay([spec], [invalid, invalid])):  # fmt: skip
        assert figure._repr_png_().startswith(b"\x89PNG")


def test_shade_is_no_curve(invalid):
    assert not [c for c in invalid.plot().axes[0].collections if isinstance(c, PolyCollection)]


def test_reason_of_invalidity_does_not_lie_under_the_legend(invalid):
    other = cosim.simulate(spinning(1.0, limit=2.0), stop_time=1.0, compiled=False)
    [figure] = draw_overlay([FigureSpec("Angle", (("angle",),))], [invalid, other])
    figure.canvas.draw()
    boxes = [legend.get_window_extent() for legend in figure.legends]
    if figure.get_supxlabel():
        boxes.append(figure._supxlabel.get_window_extent())
    assert "invalid from 0.5 s" in words(figure)
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
