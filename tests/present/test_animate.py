"""Files that show runs in three dimensions: their content, and what is rejected."""

import base64
import gzip
import io
import json
import re
import subprocess
import warnings
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import spinning
from PIL import Image

import cosim
from cosim.coupling.files import read_system
from cosim.drawing.camera import View, scale_of
from cosim.drawing.meshes import arrow, joined, mesh_of
from cosim.drawing.picture import draw_pose
from cosim.drawing.pose import POINT
from cosim.errors import ExportError, MissingTool, UnknownName, UsageError
from cosim.present.playback.animate import Animation, animate, drawing_of
from cosim.present.playback.playback import playback
from cosim.trajectory import Column, Trajectory


@pytest.fixture(scope="module")
def run():
    return cosim.simulate(spinning(4.0), stop_time=1.0, compiled=False)


@pytest.fixture(scope="module")
def invalid():
    dae = spinning(4.0, limit=2.0)
    return cosim.simulate(dae, stop_time=1.0, compiled=False)


def test_html_is_one_file_without_the_network_and_the_same_twice(run, tmp_path):
    first, second = (animate(run, tmp_path / name) for name in ("a.html", "b.html"))
    content = first.read_text(encoding="utf-8")
    assert content == second.read_text(encoding="utf-8")
    assert "<title>spinning, cvodes</title>" in content
    for tag in ("<script src=", "<link"):
        assert tag not in content


def test_page_holds_bodies_loads_paths_curves_and_validity(invalid):
    facts = facts_of(animate(invalid).page)
    assert facts["bodies"] == ["world", "disk"]
    assert "mark" in [solid["name"] for solid in facts["solids"]]
    assert [load["name"] for load in facts["loads"]] == ["pull", "twist"]
    assert [path["name"] for path in facts["paths"]] == ["rim"]
    [recorded] = facts["runs"]
    assert recorded["invalid_from"] == pytest.approx(0.5)
    assert recorded["reasons"][0] == "not fulfilled: the disk turns by less than 2 rad"
    assert recorded["width"] == 12 * 2 + 2 * 6 + 3
    _, *curves = curves_of(recorded)
    for column, values in zip(facts["columns"], curves, strict=True):
        np.testing.assert_allclose(values, invalid[column["name"]], rtol=1e-6)


def test_times_of_a_page_are_exact_far_from_zero():
    """Near 1e6 s, floats of 4 bytes are 0.06 s apart."""
    run = cosim.simulate("crank_shaft", start_time=1e6, stop_time=1e6 + 0.1)
    [recorded] = facts_of(animate(run).page)["runs"]
    np.testing.assert_allclose(curves_of(recorded)[0], run.time, rtol=0, atol=1e-8)


def curves_of(recorded):
    """Return the times and the curves of a recorded run."""
    n, m, width = (recorded[name] for name in ("n", "m", "width"))
    numbers = np.frombuffer(gzip.decompress(base64.b64decode(recorded["packed"])), "<f4")
    own = numbers[n * (1 + width) :].reshape(-1, m).astype(float)
    bases, sizes = (np.array(recorded[key])[1 + width :, None] for key in ("bases", "sizes"))
    assert len(own) == len(bases)
    return bases + sizes * own


def numbers_over_time(**values):
    """Return a run of made-up numbers, drawn as a point."""
    columns = tuple(Column(name, "1") for name in values)
    table = np.column_stack([np.array(v, dtype=float) for v in values.values()])
    time = np.linspace(0.0, 1.0, len(table))
    return Trajectory("numbers", time, columns, table, drawing=POINT, numbers={})


@pytest.mark.filterwarnings("error")
def test_curves_of_a_page_hold_numbers_of_any_size_and_small_changes_of_large_ones():
    swing = np.sin(np.arange(20.0))
    sizes = {"late": 1e9 + 1e-3 * swing, "tiny": 1e-200 * swing, "huge": 1e300 * swing}
    run = numbers_over_time(**sizes, gap=np.where(swing > 0, swing, np.nan), zero=0 * swing)
    _, *curves = curves_of(facts_of(animate(run).page)["runs"][0])
    for found, name in zip(curves, run.names, strict=True):
        span = np.ptp(run[name][np.isfinite(run[name])])
        np.testing.assert_allclose(found, run[name], rtol=1e-15, atol=1e-7 * span, err_msg=name)
    assert not curves[-1].any()


@pytest.mark.parametrize(
    ("values", "chosen"),
    [
        ({"a": [0.0, 0.0], "b": [1.0, 1.0]}, [0, 1]),
        ({"a": [1.0], "b": [2.0]}, [0, 1]),
        ({"a": [2.0, 2.0, 2.0], "b": [0.0, np.nan, 1.0]}, [1]),
    ],
)
def test_a_page_shows_curves_at_first_even_of_a_run_at_rest_or_with_gaps(values, chosen):
    assert facts_of(animate(numbers_over_time(**values)).page)["chosen"] == chosen


def with_number(run, name, rows, number=np.nan):
    values = np.array(run.values)
    values[rows, run.names.index(name)] = number
    return replace(run, values=values)


def test_a_page_leaves_out_the_times_at_which_bodies_have_no_place(run):
    [whole] = facts_of(animate(run).page)["runs"]
    gap = with_number(run, "angle", slice(40, 60))
    note = "the places of the bodies are not finite; such times are left out"
    with pytest.warns(UserWarning, match=note):
        [recorded] = facts_of(animate(gap).page)["runs"]
    assert 0.7 <= recorded["n"] / whole["n"] < 0.8
    nowhere = with_number(run, "angle", slice(None))
    with pytest.raises(UsageError, match="at 0 s the places of the bodies are not finite; draw"):
        animate(nowhere)
    with pytest.raises(UsageError, match=r"at 0\.5 s the places of the bodies"):
        animate(gap, "x.png", at=[0.5])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_an_arrow_without_a_number_is_not_drawn(number, tmp_path):
    gap = with_number(cosim.simulate("crank_shaft", stop_time=0.1), "fx_A", 5, number)
    assert animate(gap, tmp_path / "x.html").stat().st_size > 1e5
    assert animate(gap, tmp_path / "x.png").stat().st_size > 1e4


def test_a_further_run_without_output_times_is_rejected(run):
    empty = replace(run, time=run.time[:0], values=run.values[:0])
    with pytest.raises(UsageError, match="the run has no output times"):
        animate([run, empty])


@pytest.mark.parametrize("look", [{"dpi": 0}, {"size": (0, 3)}, {"size": (-1, -1)}, {"dpi": 1e9}])
@pytest.mark.parametrize("ending", ["png", "gif"])
def test_a_picture_with_no_pixels_or_too_many_is_rejected(run, look, ending, tmp_path):
    with pytest.raises(
        UsageError, match=r"a picture cannot have .* pixels; change its size or dpi"
    ):
        animate(run, tmp_path / f"x.{ending}", **look)


@pytest.mark.parametrize("ending", ["png", "gif", "pdf"])
@pytest.mark.parametrize(
    ("look", "words"),
    [
        ({"dpi": 3}, "at 3 dpi, letters are smaller than a pixel"),  # before: an error of FreeType
        ({"size": (6.0,)}, "size was given .*; give 2 values"),
        ({"size": (6.0, 4.0, 1.0)}, "size was given .*; give 2 values"),
        ({"size": ("a", "b")}, "size was given .*; give 2 values"),
        ({"size": [[6.0, 4.0]]}, "size was given .*; give 2 values"),
    ],
)
def test_a_picture_of_another_kind_of_size_is_rejected(run, look, words, ending, tmp_path):
    with pytest.raises(UsageError, match=words):
        cosim.animate(run, tmp_path / f"x.{ending}", **look)
    assert not (tmp_path / f"x.{ending}").exists()


def test_a_picture_without_a_time_is_rejected(run, tmp_path):
    with pytest.raises(UsageError, match="there is no time to draw"):
        animate(run, tmp_path / "x.png", at=[])  # before: cannot reshape array


def facts_of(page):
    text = re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.DOTALL)
    return json.loads(text[1])


@pytest.mark.slow
def test_page_that_computes_knows_what_can_be_set():
    pytest.importorskip("ziglang")
    facts = facts_of(animate(cosim.load("bicycle")).page)
    live = facts["live"]
    settings = {setting["name"]: setting for setting in live["settings"]}
    assert settings["phi_dot"]["kind"] == "start"
    assert settings["steer_torque"]["kind"] == "input"
    assert settings["w"]["kind"] == "parameter"
    rate = settings["thetaR_dot"]
    assert rate["low"] < rate["value"] < rate["high"]
    assert live["settings"][0] == settings["speed"]
    assert settings["speed"]["through"] == "thetaR_dot"
    assert settings["speed"]["value"] == pytest.approx(4.6)
    assert settings["thetaR"]["high"] == pytest.approx(np.pi)  # an angle goes around once
    assert facts["runs"] == [{}]
    assert live["times"][-1] == 20
    assert base64.b64decode(live["program"])[:2] == b"\x1f\x8b"


@pytest.mark.slow
def test_parameters_that_are_start_values_are_shown_as_such():
    pytest.importorskip("ziglang")
    facts = facts_of(animate(cosim.load("double_pendulum")).page)
    kinds = {setting["name"]: setting["kind"] for setting in facts["live"]["settings"]}
    assert kinds["psi1_0"] == kinds["w2_z0"] == "start"
    assert kinds["length"] == kinds["g"] == "parameter"


@pytest.mark.slow
def test_a_parameter_that_events_use_is_none_that_gives_a_start_value():
    pytest.importorskip("ziglang")
    model = cosim.Model("oven", stop_time=1.0)
    heat = model.state("heat", "1", 0.0, "energy in it")
    limit, first = (model.parameter(name, "1", 1.0, "a bound") for name in ("limit", "first"))
    on = model.discrete("on", "1", 0.0, "whether it heats")
    model.start(on, limit + first > 1.5, "it heats if a bound is large")
    model.derivative(heat, on)
    model.when(heat > limit, {on: 0}, name="hot")
    facts = facts_of(animate(model.freeze()).page)
    kinds = {setting["name"]: setting["kind"] for setting in facts["live"]["settings"]}
    assert (kinds["limit"], kinds["first"]) == ("parameter", "start")


def test_only_a_page_computes(tmp_path):
    with pytest.raises(UsageError, match=r"only a page computes; name an \.html file, not \.png"):
        animate(cosim.load("crank_shaft"), tmp_path / "x.png")


def test_bicycle_of_twenty_seconds_stays_below_three_megabytes(tmp_path):
    run = cosim.simulate(cosim.load("bicycle"), compiled=False)
    path = run.animate(tmp_path / "bicycle.html")
    assert path.stat().st_size < 3e6  # measured 1.8e6


def test_notebook_shows_the_animation_itself(run):
    shown = run.animate()
    assert isinstance(shown, Animation)
    assert shown._repr_html_().startswith('<iframe srcdoc="&lt;!')


@pytest.mark.slow_rows("mp4")
@pytest.mark.parametrize("kind", ["gif", "mp4"])
def test_movie_has_every_frame(run, tmp_path, kind):
    if kind == "mp4":
        pytest.importorskip("imageio_ffmpeg")
    path = animate(run, tmp_path / f"x.{kind}", size=(3, 2), dpi=60)
    if kind == "gif":
        with Image.open(path) as movie:
            assert movie.n_frames >= 15
            assert movie.size == (180, 120)
    else:
        assert path.read_bytes()[4:8] == b"ftyp"


@pytest.mark.quick_rows("4.0-0.01-1.0-1.0", "90.0-0.007-1.0-1.0")
@pytest.mark.parametrize(
    ("interval", "speed", "length"), [(0.01, 1.0, 1.0), (0.01, 0.3, 3.3), (0.007, 1.0, 1.0)]
)
@pytest.mark.parametrize("rate", [4.0, 90.0])
def test_a_gif_lasts_as_long_as_its_run_in_pictures_that_browsers_show(
    rate, interval, speed, length, tmp_path
):
    run = cosim.simulate(spinning(rate), stop_time=1.0, output_interval=interval, compiled=False)
    path = animate(run, tmp_path / "x.gif", size=(1, 1), dpi=20, speed=speed)
    with Image.open(path) as movie:
        lengths = []
        for i in range(movie.n_frames):
            movie.seek(i)
            lengths.append(movie.info["duration"] / 1000)
    assert min(lengths) >= 0.02
    # the first picture and the last one count, too
    assert sum(lengths[:-1]) == pytest.approx(length, abs=0.03 + lengths[-1])


def pixels(figure):
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=100)
    return np.asarray(Image.open(content).convert("RGB")).astype(int)


def reddish(picture):
    """Return the rows and columns of the disk's orange."""
    r, g, b = np.moveaxis(picture, -1, 0)
    return np.argwhere((r > 1.6 * g) & (r > 100) & (g > 1.5 * (b + 1)))


def test_picture_shows_bodies_where_the_run_says(run):
    plain = replace(run.drawing, arrows=(), traces=())
    seen = []
    for angle in (0.0, np.pi / 2):
        played = playback(run, plain, times=[angle / 4.0])
        found = reddish(pixels(draw_pose([played], [0], view=View.FRONT)))
        assert len(found) > 500
        blue = np.argwhere(np.ptp(pixels(draw_pose([played], [0], view=View.TOP)), axis=2) > 100)
        seen.append(blue.mean(axis=0))
    assert np.abs(seen[0] - seen[1]).max() > 5  # the mark has moved


def test_invalid_run_is_drawn_gray_with_its_reason(invalid):
    plain = replace(invalid.drawing, arrows=(), traces=())
    good, bad = (playback(invalid, plain, times=[t]) for t in (0.1, 0.9))
    assert len(reddish(pixels(draw_pose([good], [0])))) > 500
    figure = draw_pose([bad], [0])
    texts = " ".join(text.get_text() for text in figure.axes[0].texts).replace("\n", " ")
    assert "invalid from 0.5 s: not fulfilled: the disk turns by less" in texts
    picture = pixels(figure)
    caption = np.argwhere((picture[..., 0] > 120) & (picture[..., 1] < 60))  # the red box
    assert len(reddish(picture[: caption[:, 0].min()])) == 0


def test_texts_stay_within_the_picture(invalid):
    failed = replace(invalid, status="stopped after 0.4 s: " + "something went wrong there, " * 12)
    played = playback(failed, failed.drawing, times=[0.9])
    figure = draw_pose([replace(played, reasons=(failed.status,))], [0], size=(4, 3))
    figure.canvas.draw()
    for text in figure.axes[0].texts:
        box = text.get_window_extent()
        assert box.x0 >= -1
        assert box.x1 <= 401
        assert box.y0 >= -1
        assert box.y1 <= 301


def test_ghosts_are_pale(run):
    other = cosim.simulate(spinning(2.0), stop_time=1.0, compiled=False)
    played = [playback(each, each.drawing, times=[0.5]) for each in (run, other)]
    figure = draw_pose(played, [0])
    texts = "\n".join(text.get_text() for text in figure.axes[0].texts)
    assert "pale: spinning, cvodes" in texts


def test_values_are_written_beside_each_of_several_poses(run):
    played = playback(run, run.drawing, times=[0.0, 0.5], labels=["angle"])
    texts = "\n".join(text.get_text() for text in draw_pose([played], [0, 1]).axes[0].texts)
    assert "t = 0.00 s, angle = 0 deg\nt = 0.50 s, angle = 114.6 deg" in texts


def test_everything_is_within_the_picture(run):
    for view in View:
        played = playback(run, run.drawing, times=[0.0, 0.5])
        figure = draw_pose([played], [0, 1], view=view)
        faces = np.vstack([path.vertices for path in figure.axes[0].collections[-1].get_paths()])
        assert np.abs(faces[:, 0]).max() < 6.4 / 4.8
        assert np.abs(faces[:, 1]).max() < 1


@pytest.mark.parametrize("size", [(6.4, 4.8), (3.0, 4.8), (6.4, 3.0)])
def test_bodies_and_paths_fill_the_picture_below_its_title(run, size):
    for view in View:
        played = playback(run, run.drawing, times=[0.0, 0.5])
        figure = draw_pose([played], [0, 1], view=view, follow="", size=size)
        found = figure.axes[0].collections  # the path of the rim, and the bodies
        paths = [path.vertices for collection in found for path in collection.get_paths()]
        seen = np.vstack(paths) * size[1] / 2  # inches from the middle
        assert np.abs(seen[:, 0]).max() < size[0] / 2 - 0.1
        assert -size[1] / 2 + 0.1 < seen[:, 1].min()
        assert seen[:, 1].max() < size[1] / 2 - 0.5
        share = np.ptp(seen, axis=0) / (size[0] - 0.4, size[1] - 0.77)
        assert share.max() > 0.95  # measured 0.99 to 1.01


def test_arrow_is_as_long_as_its_load(run):
    played = playback(run, run.drawing)
    scale = scale_of([played], None)
    pull = played.loads[0]
    start, end = scale.arrow(pull, 3)
    np.testing.assert_allclose(end - start, scale.per_unit["N"] * pull.vector[3])
    tip = arrow(start, end, 0.01).vertices
    along = (end - start) / np.linalg.norm(end - start)
    assert ((tip - start) @ along).max() == pytest.approx(np.linalg.norm(end - start))


def test_meshes_are_closed_and_seen_from_outside(run):
    played = playback(run, run.drawing)
    for solid in played.solids:
        mesh = mesh_of(solid)
        corners = mesh.vertices[mesh.faces]
        volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum()
        wanted = {
            "cylinder": np.pi * 0.5**2 * 0.1,
            "sphere": 4 / 3 * np.pi * 0.1**3,
            "box": 0.01,
        }[solid.kind]
        assert volume / 6 == pytest.approx(wanted, rel=0.08)  # corners of circles are cut
    assert len(joined([mesh_of(s) for s in played.solids]).faces) > 300


@pytest.mark.parametrize(
    ("target", "options", "error", "message"),
    [
        ("x.avi", {}, UnknownName, "x.avi has no animation format 'avi'"),
        (
            "x.glb",
            {},
            UnknownName,
            "that ends with .html, .mp4, .gif, .png, .svg, .pdf",
        ),
        ("x.html", {"view": "back"}, UnknownName, "no view 'back'"),
        ("x.html", {"speed": 0}, UsageError, "speed 0 is not positive"),
        ("x.html", {"at": [0.5]}, UsageError, "only a picture shows chosen times; name a .png"),
        ("x.png", {"at": [5.0]}, UsageError, "5 s lies outside the run"),
        ("x.png", {"labels": ["angel"]}, UnknownName, "did you mean angle?"),
        ("x.png", {"follow": "cart"}, UsageError, "no body 'cart' to follow; there are disk"),
        ("missing/x.png", {}, ExportError, "create"),
    ],
)
def test_what_cannot_be_shown_is_rejected(run, tmp_path, target, options, error, message):
    with pytest.raises(error, match=r".") as refusal:
        animate(run, tmp_path / target, **options)
    assert message in str(refusal.value)


def test_run_of_an_unknown_model_asks_for_one(run):
    with pytest.raises(UsageError, match=r"no model of this name has shapes to draw.*--model"):
        animate(replace(run, drawing=None), "x.png")


def test_run_without_a_drawing_takes_that_of_a_model(run, tmp_path):
    path = animate(replace(run, drawing=None), tmp_path / "x.png", model=spinning(4.0))
    assert path.stat().st_size > 1000


ARM = {"length": 1.5}  # m, three times the pendulum's own


def height_of_the_tip(run):
    """Return the lowest point of the drawn path of the tip, m."""
    played = playback(run, drawing_of(run), times=[0.0])
    return min(path.points[:, 2].min() for path in played.paths)


@pytest.mark.slow
def test_variants_and_fmus_are_drawn_with_the_parameters_they_ran_with(exported):
    span = {"stop_time": 0.2, "output_interval": 0.1}
    native = cosim.simulate("double_pendulum", start_values=ARM, **span)
    many = cosim.simulate_many(
        cosim.load("double_pendulum"), {"length": [0.5, ARM["length"]]}, **span
    )
    fmu = cosim.simulate_fmu(exported("double_pendulum/quaternion"), start_values=ARM, **span)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        expected = height_of_the_tip(native)
        for run in (many.run(1), fmu):
            assert height_of_the_tip(run) == pytest.approx(expected, rel=1e-4)
            rod = playback(run, drawing_of(run), times=[0.0]).solids
            assert any(ARM["length"] in solid.size for solid in rod)
    assert native.numbers["length"] == fmu.numbers["length"] == ARM["length"]
    assert height_of_the_tip(many.run(0)) > expected / 2


def test_run_from_a_file_warns_that_it_takes_the_models_parameters(tmp_path):
    cosim.simulate("double_pendulum", stop_time=0.1).to_csv(tmp_path / "run.csv")
    read = replace(cosim.Trajectory.read_csv(tmp_path / "run.csv"), model="double_pendulum")
    with pytest.warns(UserWarning, match="does not know its parameters; it is drawn with those of"):
        animate(read, tmp_path / "x.png")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        animate(replace(read, numbers={"length": 0.5}), tmp_path / "x.png")


@pytest.mark.parametrize(("package", "kind"), [("meshcat", "html"), ("imageio_ffmpeg", "mp4")])
def test_missing_extra_names_the_command(run, tmp_path, monkeypatch, package, kind):
    import sys

    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingTool, match=r'pip install "cosim-rigid\[animate\]"') as refusal:
        animate(run, tmp_path / f"x.{kind}")
    assert refusal.value.exit_code == 5
    assert not (tmp_path / f"x.{kind}").exists()


@pytest.mark.slow
def test_importing_the_package_imports_no_extra():
    import sys

    code = "import sys, cosim.present.playback.animate; print([m for m in ('meshcat', "
    code += "'imageio_ffmpeg', 'uplot') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_input_does_not_hide_the_curve_that_it_is_connected_to(tmp_path):
    run = cosim.simulate(read_system("examples/coupled/quarter_car.toml").dae, compiled=False)
    data = facts_of(animate(run, tmp_path / "x.html").read_text("utf-8"))
    chosen = [data["columns"][k]["name"] for k in data["chosen"]]
    assert chosen[:2] == ["wheel.x", "chassis.x"]
    assert "chassis.x_wheel" not in chosen
