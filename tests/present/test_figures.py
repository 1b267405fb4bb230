"""Figures: what is drawn, in which units, and how it reaches a file."""

import io
import subprocess
import sys
import zlib
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import cosim
from cosim.api import execute
from cosim.cli.main import main
from cosim.errors import ExportError, SolverError, UnknownName, UsageError
from cosim.plotting import keep_constant_flat, save
from cosim.present.figures import draw_figures, draw_overlay, shared_specs
from cosim.scene.scene import FigureSpec
from cosim.scene.variants import variant
from cosim.trajectory import Column, Trajectory

POUND, DEGREE = 4.4482216152605, np.pi / 180


def made_up(**values):
    """Return a run of made-up curves in newton, shown in pound."""
    time = np.linspace(0.0, 2.0, len(next(iter(values.values()))))
    columns = tuple(Column(name, "N", "lbf", 1.0, f"force {name}") for name in values)
    table = np.column_stack([np.array(v, dtype=float) for v in values.values()])
    return Trajectory("made_up", time, columns, table, {"solver": "none"})


def curves(axis):
    return [line.get_ydata() for line in axis.get_lines()]


@pytest.fixture(scope="module")
def path_run():
    return cosim.simulate(cosim.load("bicycle"), stop_time=0.5)


def test_curves_of_a_panel_stand_in_one_unit():
    run = made_up(a=[POUND, 0.0], b=[POUND, 0.0])
    plain = replace(run.column("b"), display_unit=None)
    run = replace(run, columns=(run.column("a"), plain))
    (figure,) = draw_figures([FigureSpec("F", (("a", "b"),))], run)
    (axis,) = figure.axes
    assert axis.get_ylabel() == "a, b [lbf]"
    np.testing.assert_allclose([y[0] for y in curves(axis)], [1, 1])


def test_a_run_of_a_single_row_is_seen():
    run = made_up(a=[POUND])
    spec = FigureSpec("F", (("a",),))
    for figure in (run.plot(), *draw_figures([spec], run), *draw_figures([spec], run, run)):
        for axis in figure.axes:
            assert {line.get_marker() for line in axis.get_lines()} == {"."}


def test_a_run_without_rows_has_empty_panels():
    run = replace(made_up(a=[POUND]), time=np.empty(0), values=np.empty((0, 1)))
    for figure in (run.plot(), *draw_figures([FigureSpec("F", (("a",),))], run)):
        assert len(figure.axes) == 1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("gap", [np.nan, np.inf])
def test_gaps_in_a_constant_neither_widen_it_nor_hide_that_runs_are_equal(gap):
    run = made_up(a=[POUND, gap, POUND, POUND * (1 + 1e-12)])
    panel, below = draw_figures([FigureSpec("F", (("a",),))], run, run)[0].axes
    np.testing.assert_allclose(panel.get_ylim(), [0.9, 1.1], rtol=1e-9)
    assert [text.get_text() for text in below.texts] == ["exactly zero"]
    nowhere = made_up(a=[np.nan, np.nan])
    _, below = draw_figures([FigureSpec("F", (("a",),))], nowhere, nowhere)[0].axes
    assert not below.texts


def test_curves_stand_in_display_units_under_their_title():
    run = made_up(a=[0.0, POUND, 2 * POUND])
    (figure,) = draw_figures([FigureSpec("Force at A", (("a",),))], run)
    (axis,) = figure.axes
    np.testing.assert_allclose(curves(axis)[0], [0, 1, 2], rtol=0, atol=1e-15)
    assert figure.get_suptitle() == "Force at A"
    assert axis.get_ylabel() == "a [lbf]"
    assert axis.get_xlabel() == "time [s]"


def test_panels_stand_below_each_other_with_their_labels():
    run = made_up(a=[0, 1, 2], b=[5, 3, 1])
    (figure,) = draw_figures([FigureSpec("F", (("a",), ("b",)), labels=("first", "second"))], run)
    assert [axis.get_ylabel() for axis in figure.axes] == ["first [lbf]", "second [lbf]"]
    assert [axis.get_xlabel() for axis in figure.axes] == ["", "time [s]"]


def test_several_curves_in_a_panel_have_a_legend():
    run = made_up(a=[0, 1, 2], b=[5, 3, 1])
    plain, named = draw_figures(
        [FigureSpec("F", (("a", "b"),)), FigureSpec("F", (("a", "b"),), legends=(("left", "b"),))],
        run,
    )
    assert [t.get_text() for t in plain.axes[0].get_legend().get_texts()] == [
        "a: force a",
        "b: force b",
    ]
    assert named.axes[0].get_legend().get_texts()[0].get_text() == "left"


@pytest.mark.slow
def test_path_is_drawn_to_scale(path_run):
    spec = FigureSpec("Path", (("xP",),), x="yP", x_label="Y of P", equal=True)
    (figure,) = draw_figures([spec], path_run)
    (axis,) = figure.axes
    assert axis.get_aspect() == 1
    assert axis.get_xlabel() == "Y of P [m]"
    np.testing.assert_array_equal(axis.get_lines()[0].get_xdata(), path_run["yP"])


def test_difference_of_two_runs_stands_below_in_display_units():
    run, other = made_up(a=[0, 1, 2]), made_up(a=[0, 1 + POUND, 2 - 2 * POUND])
    (figure,) = draw_figures([FigureSpec("F", (("a",),))], run, other)
    above, below = figure.axes
    assert len(curves(above)) == 2
    np.testing.assert_allclose(curves(below)[0], [0, 1, -2], rtol=0, atol=1e-15)
    assert below.get_ylabel() == "difference [lbf]"


def test_difference_of_two_paths_is_drawn_over_time_for_both_coordinates(path_run):
    spec = FigureSpec("Path", (("xP",),), x="yP", equal=True)
    (figure,) = draw_figures([spec], path_run, path_run)
    below = figure.axes[1]
    assert [np.abs(curve).max() for curve in curves(below)] == [0, 0]
    assert [t.get_text() for t in below.get_legend().get_texts()] == ["yP", "xP"]
    assert below.get_xlabel() == "time [s]"


def test_runs_with_other_output_times_are_refused():
    with pytest.raises(UsageError, match="different output times"):
        draw_figures([FigureSpec("F", (("a",),))], made_up(a=[0, 1]), made_up(a=[0, 1, 2]))


def test_figures_of_two_plain_runs_hold_every_common_variable_once():
    run = made_up(a=[0, 1], b=[0, 1], c=[0, 1], d=[0, 1])
    other = made_up(d=[0, 1], a=[0, 1], b=[1, 1], c=[0, 1], e=[1, 2])
    specs, _ = shared_specs((), (run, other))
    assert [spec.names for spec in specs] == [("a", "b", "c"), ("d",)]
    with pytest.raises(UsageError, match="no variable in common"):
        shared_specs((), (run, made_up(z=[0, 1])))


@pytest.mark.parametrize("value", [0.0, 5.0 * POUND])
def test_numerical_noise_of_a_constant_does_not_fill_its_panel(value):
    noise = 1e-12 * np.random.default_rng(7).standard_normal(50)
    (figure,) = draw_figures([FigureSpec("F", (("a",),))], made_up(a=value + noise))
    low, high = figure.axes[0].get_ylim()
    assert high - low > 0.1
    assert low < value / POUND < high


def test_small_motion_is_no_constant():
    run = made_up(a=1e-6 * np.sin(np.arange(50)))
    (figure,) = draw_figures([FigureSpec("F", (("a",),))], run)
    low, high = figure.axes[0].get_ylim()
    assert high - low < 1e-6


def test_run_that_failed_is_labeled():
    run = made_up(a=[0, 1])
    failed = Trajectory(run.model, run.time, run.columns, run.values, {}, "stopped after 2 s: why")
    (figure,) = draw_figures([FigureSpec("F", (("a",),))], failed)
    assert "stopped after 2 s" in figure.axes[0].get_title(loc="right")


def test_overview_draws_every_variable_with_its_unit():
    figure = made_up(a=[0, 1], b=[0, 1], c=[0, 1], d=[0, 1]).plot()
    shown = [axis for axis in figure.axes if axis.get_visible()]
    assert [axis.get_ylabel() for axis in shown] == [f"{n} [lbf]" for n in "abcd"]


@pytest.mark.slow
def test_book_draws_nineteen_figures_of_the_bicycle():
    scene = cosim.read_scene("bicycle_model_1.toml")
    run = cosim.run_scene(scene)
    figures = draw_figures(scene.figures, run)
    assert len(figures) == 19
    yaw = curves(figures[0].axes[0])[0]
    # The book: yaw tends to 13.65 deg; wheel rates to -15.41 and -13.21 rad/s
    assert yaw[-1] == pytest.approx(13.65, abs=0.01)
    rear, front = curves(figures[18].axes[0])
    assert rear[-1] == pytest.approx(-15.41, abs=0.005)
    assert front[-1] == pytest.approx(-13.21, abs=0.005)


def test_book_numbers_of_crank_and_bar_stand_in_their_figures():
    scene = cosim.read_scene("crank_shaft.toml")
    force, torque, _ = draw_figures(scene.figures, cosim.run_scene(scene))
    assert curves(force.axes[0])[0][0] == pytest.approx(-6.4994, abs=5e-5)
    assert curves(force.axes[1])[0][0] == pytest.approx(0.025998, abs=5e-7)
    assert curves(torque.axes[0])[0][0] == pytest.approx(0.086659, abs=5e-7)
    scene = cosim.read_scene("bar_on_frame.toml")
    figures = {f.get_suptitle(): f for f in draw_figures(scene.figures, cosim.run_scene(scene))}
    force = figures["Force Components on the Bar (expressed in F)"]
    np.testing.assert_allclose(curves(force.axes[0])[0], -0.2, rtol=0, atol=1e-12)
    torque = figures["Torque Components Acting on Bar (expressed in F)"]
    assert curves(torque.axes[1])[0][-1] == pytest.approx(0.016656, abs=5e-7)


@pytest.mark.slow
def test_compared_formulations_differ_by_no_more_than_their_tolerance():
    scene = cosim.read_scene("bar_theta.toml")
    other, backend = variant(scene.request, "two_body")
    second = execute(other.reduced(), backend)
    (figure,) = draw_figures(scene.figures, cosim.run_scene(scene), second)
    gap = np.abs(curves(figure.axes[1])[0]).max() * DEGREE
    assert 0 < gap < 2e-6  # measured 2.2e-7 rad at rtol 1e-8


# -- files ----------------------------------------------------------------------------------------


@pytest.fixture
def figures():
    run = made_up(a=[0, 1, 2], b=[3, 4, 0])
    return draw_figures([FigureSpec("A", (("a",),)), FigureSpec("B", (("b",),))], run)


@pytest.mark.parametrize(
    ("ending", "magic"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("PNG", b"\x89PNG")]
)
def test_several_figures_become_numbered_files(figures, tmp_path, ending, magic):
    paths = save(figures, str(tmp_path / f"x.{ending}"))
    assert [path.name for path in paths] == [f"x-01.{ending}", f"x-02.{ending}"]
    assert sorted(tmp_path.iterdir()) == paths
    assert all(path.read_bytes().startswith(magic) for path in paths)


def test_one_figure_keeps_the_name(figures, tmp_path):
    assert save(figures[:1], str(tmp_path / "x.svg")) == [tmp_path / "x.svg"]


def test_several_figures_become_pages_of_one_pdf(figures, tmp_path):
    (path,) = save(figures, str(tmp_path / "x.pdf"))
    content = path.read_bytes()
    assert content.startswith(b"%PDF")
    parts = content.split(b"stream\n")[1::2]
    objects = [zlib.decompressobj().decompress(p) for p in parts if p[:1] == b"x"]
    assert sum(text.count(b"/Type /Page ") for text in (content, *objects)) == 2


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_same_figures_give_the_same_bytes(tmp_path, ending):
    spec, run = FigureSpec("A", (("a",),)), made_up(a=[0, 1, 2])
    first, second = (
        save(draw_figures([spec], run), str(tmp_path / f"{i}.{ending}"))[0] for i in (1, 2)
    )
    assert first.read_bytes() == second.read_bytes()


def test_unknown_ending_is_refused_and_nothing_written(figures, tmp_path):
    with pytest.raises(UnknownName, match=r"no picture format 'jpg'"):
        save(figures, str(tmp_path / "x.jpg"))
    assert list(tmp_path.iterdir()) == []


def test_missing_folder_is_named(figures, tmp_path):
    with pytest.raises(ExportError, match=r"create .*none first"):
        save(figures, str(tmp_path / "none" / "x.png"))


# -- command line ---------------------------------------------------------------------------------


def test_plot_of_a_scene_writes_its_figures(tmp_path, capsys):
    target = tmp_path / "crank.svg"
    assert main(["plot", "crank_shaft.toml", "--output-file", str(target)]) == 0
    names = [f"crank-0{i}.svg" for i in (1, 2, 3)]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert all(name in capsys.readouterr().err for name in names[:1])


@pytest.mark.slow
def test_plot_of_a_model_writes_the_overview(tmp_path):
    target = tmp_path / "crank.png"
    assert main(["plot", "crank_shaft", "--output-file", str(target), "-q"]) == 0
    assert list(tmp_path.iterdir()) == [target]


def test_plot_with_other_outputs_draws_these_instead_of_the_scenes_figures(tmp_path):
    target = tmp_path / "crank.png"
    options = ["--outputs", "phi", "--output-file", str(target), "-q"]
    assert main(["plot", "crank_shaft.toml", *options]) == 0
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    "backend", ["native-interpreted", "fmu-me", "fmu-cs", "erk", "multipliers"]
)
def test_plot_compares_with_any_backend(tmp_path, backend):
    target = tmp_path / "crank.png"
    options = ["--compare", backend, "--output-file", str(target), "-q"]
    assert main(["plot", "crank_torque.toml", *options]) == 0
    assert target.exists()


@pytest.mark.slow
def test_plot_compares_plain_models(tmp_path):
    target = tmp_path / "crank.pdf"
    options = ["--compare", "multipliers", "--stop-time", "0.1", "--output-file", str(target)]
    assert main(["plot", "crank_shaft", *options]) == 0


def test_unknown_backend_is_exit_code_3(tmp_path, capsys):
    options = ["--compare", "multiplier", "--output-file", str(tmp_path / "x.png")]
    assert main(["plot", "crank_torque.toml", *options]) == 3
    assert "did you mean multipliers" in capsys.readouterr().err


def test_unknown_ending_is_told_before_anything_is_computed(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("cosim.cli.runs.run_scene", None)
    target = tmp_path / "x.bmp"
    assert main(["plot", "bicycle_model_1.toml", "--output-file", str(target)]) == 3
    assert "no picture format 'bmp'" in capsys.readouterr().err


def test_failed_run_is_drawn_as_far_as_it_went(tmp_path, capsys, monkeypatch):
    run = made_up(a=[0, 1, 2])
    partial = Trajectory(run.model, run.time, run.columns, run.values, {}, "stopped after 2 s: x")

    def fail(*_arguments, **_options):
        raise SolverError("it stopped", partial)

    monkeypatch.setattr("cosim.cli.runs.run_scene", fail)
    target = tmp_path / "x.png"
    assert main(["plot", "crank_shaft", "--output-file", str(target)]) == 1
    assert target.exists()
    assert "it stopped" in capsys.readouterr().err


def test_window_needs_no_file(monkeypatch):
    shown = []
    monkeypatch.setattr("cosim.cli.verbs.plot.show", shown.extend)
    monkeypatch.setattr("cosim.cli.verbs.plot.require_screen", lambda: None)
    assert main(["plot", "crank_torque.toml"]) == 0
    assert [isinstance(figure, Figure) for figure in shown] == [True]


def test_window_without_a_screen_is_refused_before_the_run(monkeypatch, capsys):
    monkeypatch.setattr("cosim.cli.runs.run_scene", None)
    assert main(["plot", "crank_torque.toml"]) == 2
    assert "there is no screen" in capsys.readouterr().err


@pytest.mark.slow
def test_drawing_needs_no_screen(tmp_path):
    code = "from cosim.cli.main import main; raise SystemExit(main())"
    command = [sys.executable, "-c", code, "plot", "crank_torque.toml", "--output-file", "x.png"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "x.png").exists()


@pytest.mark.parametrize(("header", "label"), [("phi", "phi"), ("phi [deg]", "phi [deg]")])
def test_axis_of_a_file_without_units_names_none(tmp_path, header, label):
    (tmp_path / "run.csv").write_text(f"time,{header}\n0,1\n1,2\n")
    run = cosim.Trajectory.read_csv(tmp_path / "run.csv")
    assert [axis.get_ylabel() for axis in run.plot().axes] == [label]


@pytest.mark.parametrize("header", ["phi", "phi [rad]", "phi [deg]"])
@pytest.mark.parametrize("first", [True, False], ids=["file first", "model first"])
def test_file_next_to_a_model_is_drawn_in_the_units_of_the_label(path_run, tmp_path, header, first):
    values = path_run["phi"] / (DEGREE if "deg" in header else 1)
    lines = [f"{t:.17g},{v:.17g}" for t, v in zip(path_run.time, values, strict=True)]
    (tmp_path / "phi.csv").write_text("\n".join([f"time,{header}", *lines]))
    runs = [Trajectory.read_csv(tmp_path / "phi.csv"), path_run]
    specs, _ = shared_specs((), runs)
    (figure,) = draw_overlay(specs, runs if first else runs[::-1])
    (axis,) = figure.axes
    unit = "rad" if first and "rad" in header else "deg"
    assert axis.get_ylabel() == f"phi [{unit}]"
    for curve in curves(axis):
        own = path_run["phi"] / (DEGREE if unit == "deg" else 1)
        np.testing.assert_allclose(curve, own, rtol=1e-12)


@pytest.mark.slow
def test_axes_are_scaled_by_the_valid_part_of_a_run():
    run = cosim.simulate("bicycle", start_values={"phi_dot": 2.5}, stop_time=1.0, compiled=False)
    start, _ = run.validity
    (axis, *_) = run.select(["fy_P"]).plot().axes
    valid = run["fy_P"][run.time < start]
    low, high = axis.get_ylim()
    assert low <= valid.min() < valid.max() <= high
    assert high - low <= 2.01 * np.ptp(valid)


def test_three_compared_runs_have_their_differences_below_and_a_whole_legend():
    dae = cosim.load("crank_shaft")
    runs = [cosim.simulate(dae, solver=s, stop_time=1.0) for s in ("cvodes", "dop853", "erk")]
    runs = [replace(run, stats={**run.stats, "variation": 40 * "long "}) for run in runs]
    specs, _ = shared_specs((), [run.select(["phi"]) for run in runs])
    [figure] = draw_overlay(specs, runs, differences=True)
    _, below = figure.axes
    assert below.get_ylabel() == "difference [deg]"
    expected = np.degrees(runs[2]["phi"]) - np.degrees(runs[0]["phi"])
    drawn = below.get_lines()[1].get_ydata()
    np.testing.assert_allclose(drawn, expected, rtol=0, atol=1e-11)  # deg; measured 5e-13
    figure.canvas.draw()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.width


def test_runs_at_other_times_are_drawn_over_each_other_without_differences():
    dae = cosim.load("crank_shaft")
    runs = [cosim.simulate(dae, stop_time=t, outputs=["phi"]) for t in (1.0, 1.0, 0.5)]
    specs, _ = shared_specs((), runs)
    [figure] = draw_overlay(specs, runs, differences=True)
    assert len(figure.axes) == 1


@pytest.mark.slow
def test_values_in_a_legend_have_their_unit(tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr("cosim.cli.verbs.plot.save", lambda figures, *_: shown.extend(figures))
    monkeypatch.setattr("cosim.cli.verbs.plot.note", lambda *_: None)
    monkeypatch.setattr("cosim.cli.verbs.plot.draw_overlay", lambda specs, runs, **_: runs)
    words = ["-p", "speed=3.5,4.5", "--stop-time", "0.1", "--outputs", "phi"]
    main(["plot", "bicycle", *words, "-o", str(tmp_path / "x.png")])
    assert [run.stats["variation"] for run in shown] == ["speed=3.5 m/s", "speed=4.5 m/s"]


@pytest.mark.parametrize(("size", "texts"), [(0.0, []), (2.5e-12, ["at most 2.5e-12"])])
def test_curve_that_looks_like_zero_says_how_large_it_is(size, texts):
    axis = Figure().subplots()
    keep_constant_flat(axis, size * np.array([0.0, 1.0, -1.0]), 20.0)
    assert axis.get_ylim() == (-20.0, 20.0)
    assert [text.get_text() for text in axis.texts] == texts


@pytest.mark.parametrize(
    ("meaning", "is_formula"),
    [(r"costs $5_^ and $\frac", False), ("between $a and $b$", True), (r"angle $\alpha$", True)],
)
def test_text_of_a_model_that_is_no_formula_is_drawn_as_it_is_written(meaning, is_formula):
    """A file of another tool may have dollar signs in its descriptions."""
    model = cosim.Model("cash", stop_time=1.0)
    x = model.state("x", "m", 1.0, meaning)
    model.derivative(x, -x)
    figure = cosim.simulate(model.freeze(), compiled=False).plot(["x"])
    figure.savefig(io.BytesIO())  # an error of matplotlib before
    texts = [text for text in figure.findobj(Text) if "$" in text.get_text()]
    assert {text.get_parse_math() for text in texts} == {is_formula}
    assert any(meaning in text.get_text() for text in texts)
