"""Pages in a browser: bodies stand where the run says, sliders compute, nothing is requested."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.browser import CHROMIUM, opened
from helpers.scenes import spinning

import cosim
from casadi_models.dae import Drawing
from cosim.drawing.camera import Camera, View, camera_for, scale_of
from cosim.present.playback.animate import animate
from cosim.present.playback.page import DISTANCE, page
from cosim.present.playback.playback import playback
from cosim.trajectory import Column, Trajectory

SYSTEMS = {
    "crank_shaft": "alpha",
    "bar_on_frame": "theta",
    "bicycle": "phi_dot",
    "disk_two_bars": "theta1",
    "double_pendulum": "m",
}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium"),
]

FRAMES = "for (let k = 0; k < 4; ++k) await new Promise(requestAnimationFrame);"


def asked(path, code, folder):
    """Return what JavaScript returns in a page that has no complaint and requests nothing."""
    pytest.importorskip("websockets")
    with opened(path, folder) as page:
        found = page.ask(code)
        assert page.messages == []
        assert [
            url for url in page.requests if not url.startswith(("file:", "blob:", "data:"))
        ] == []
    return found


@pytest.mark.parametrize("angle", [0.4, 2.0])
def test_a_known_point_is_where_the_run_says(angle, tmp_path):
    run = cosim.simulate(spinning(4.0), stop_time=1.0, compiled=False)
    played = playback(run, run.drawing, times=[angle / 4.0])
    path = tmp_path / "x.html"
    path.write_text(page([played], [run]), encoding="utf-8")
    code = """
        const { scene } = player, { shapes } = scene.actors[0];
        const mark = shapes.find((shape) => shape.solid.name === "mark");
        scene.scene.updateMatrixWorld(true);
        const at = new THREE.Vector3().setFromMatrixPosition(mark.group.matrixWorld);
        const seen = at.clone().project(scene.camera);
        const { position, matrix } = scene.camera;
        const axes = [0, 1, 2].map((k) => new THREE.Vector3().setFromMatrixColumn(matrix, k));
        return [[...at.toArray(), seen.x * scene.camera.aspect, seen.y], position.toArray(),
                axes.map((axis) => axis.toArray())];
    """
    found, eye, axes = asked(path, code, tmp_path)
    mark = np.array([0.5 * np.cos(angle), 0.5 * np.sin(angle), 1.0])
    first = camera_for(played.world, View.ISO, scale_of([played], None), DISTANCE)
    np.testing.assert_allclose(axes, first.axes, atol=1e-5)  # the page sets only the distance
    camera = Camera(np.array(eye), first.axes, first.up)
    np.testing.assert_allclose(found, [*mark, *camera.seen(mark)[:2]], atol=1e-5)


@pytest.mark.parametrize("model", SYSTEMS)
def test_a_slider_of_a_system_computes_the_run_that_the_fmu_gives(model, tmp_path):
    pytest.importorskip("ziglang")
    dae = cosim.load(model)
    path = animate(dae, tmp_path / "x.html")
    assert path.stat().st_size < 1.5e6
    name = SYSTEMS[model]
    code = f"""
        const slider = document.getElementById("setting {name}");
        slider.value = Number(slider.value) + 0.25 * (slider.max - slider.value);
        slider.dispatchEvent(new Event("input"));
        const setting = player.data.live.settings.find((s) => s.name === "{name}");
        {FRAMES}
        const {{ time, values }} = player.results[0].curves;
        return [slider.valueAsNumber / setting.factor, location.hash, Array.from(time),
                player.data.columns.map((c) => c.name), values.map((v) => Array.from(v))];
    """
    chosen, link, time, names, values = asked(path, code, tmp_path)
    assert link == f"#{name}={chosen!r}"
    fmu = cosim.export_fmu(dae, tmp_path / "x.fmu")
    run = cosim.simulate_fmu(
        fmu, interface="CoSimulation", start_values={name: chosen}, outputs=names
    )
    np.testing.assert_array_equal(time, run.time)
    for name, found in zip(names, values, strict=True):
        size = max(np.abs(run[name]).max(), run.column(name).nominal)
        np.testing.assert_allclose(found, run[name], rtol=0, atol=1e-9 * size, err_msg=name)


@pytest.mark.parametrize("model", SYSTEMS)
def test_every_recorded_system_moves_in_the_browser(model, tmp_path):
    run = cosim.simulate(cosim.load(model), compiled=False)
    path = animate(run, tmp_path / "x.html")
    code = f"""
        const {{ bodies }} = player.scene.actors[0];
        const seen = () => bodies.map(({{ body }}) => body.matrixWorld.toArray());
        player.go(player.begin);
        {FRAMES}
        const first = JSON.stringify(seen());
        player.go(0.4 * player.end);
        {FRAMES}
        return [first !== JSON.stringify(seen()), player.curves.charts.length > 0, player.t];
    """
    found = asked(path, code, tmp_path)
    assert found == [True, True, pytest.approx(0.4 * run.time[-1])]


def test_bodies_stay_in_the_picture_where_a_slider_makes_them_swing_wider(tmp_path):
    pytest.importorskip("ziglang")
    path = animate(cosim.load("disk_two_bars"), tmp_path / "x.html")
    code = f"""
        location.hash = "#Omega=12.5"; // twice the speed
        await new Promise((done) => setTimeout(done, 50));
        {FRAMES}
        const {{ camera, actors, scene }} = player.scene;
        let beyond = 0;
        for (let t = 0; t < 4; t += 0.1) {{
            player.scene.draw(t);
            scene.updateMatrixWorld(true);
            for (const {{ group }} of actors[0].shapes) for (const mesh of group.children) {{
                const corners = mesh.geometry.attributes.position;
                for (let k = 0; k < corners.count; ++k) {{
                    const at = new THREE.Vector3().fromBufferAttribute(corners, k);
                    at.applyMatrix4(mesh.matrixWorld).project(camera);
                    beyond = Math.max(beyond, Math.abs(at.x), Math.abs(at.y));
                }}
            }}
        }}
        return [location.hash, beyond];
    """
    link, beyond = asked(path, code, tmp_path)
    assert link == "#Omega=12.5"
    assert 0.8 < beyond < 1  # half of the picture is 1


def test_page_tells_in_words_what_it_cannot_compute(tmp_path):
    pytest.importorskip("ziglang")
    path = animate(cosim.load("crank_shaft"), tmp_path / "x.html")
    code = f"""
        const text = (name) => document.getElementById(name).textContent;
        const facts = () => text("facts") + text("alarm");
        const cost = () => document.getElementById("cost").textContent;
        const csv = document.getElementById("csv"), found = [];
        for (const link of ["#density=-1", "#density=3e4", "#nix=1", "#density=", "#omega=Infinity",
                            "#omega=1e200"]) {{
            location.hash = link;
            await new Promise((done) => setTimeout(done, 50));
            {FRAMES}
            found.push([facts(), cost(), csv.disabled]);
        }}
        return found;
    """
    impossible, possible, unknown, empty, infinite, huge = asked(path, code, tmp_path)
    assert "no run: " in impossible[0]
    assert "density" in impossible[0]
    assert impossible[2] is True
    assert "no run" not in possible[0]
    assert possible[2] is False
    assert "the link sets 'nix', which this model does not have" in unknown[1]
    assert "the link sets density to '', which is no number" in empty[1]
    assert "the link sets omega to 'Infinity', which is no number" in infinite[1]
    assert "is not finite at time 0" in huge[0]
    assert "nan" not in huge[0]  # `-nan` before


def test_keys_work_after_a_click_on_a_button(tmp_path):
    run = cosim.simulate(spinning(4.0), stop_time=1.0, compiled=False)
    path = animate(run, tmp_path / "x.html", speed=1)
    code = """
        player.go(0.5);
        const button = document.getElementById("axes");
        button.focus();
        button.click();
        for (const key of ["ArrowRight", " "])
            button.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
        return [player.t, player.playing];
    """
    t, playing = asked(path, code, tmp_path)
    assert t == pytest.approx(0.51)
    assert playing is False  # the key presses the button


def test_link_of_a_page_never_holds_infinity(tmp_path):
    pytest.importorskip("ziglang")
    path = animate(cosim.load("bar_on_frame"), tmp_path / "x.html")
    code = f"""
        const small = player.data.live.settings.find((s) => s.factor < 1);
        const field = document.querySelector(`[aria-label^="${{small.name}}, "]`);
        const before = field.value;
        field.value = "1.7e308"; // more than a double holds in SI units
        field.dispatchEvent(new Event("change"));
        {FRAMES}
        return [location.hash, field.value === before];
    """
    assert asked(path, code, tmp_path) == ["", True]


def test_time_of_a_page_never_lies_before_the_run(tmp_path):
    run = cosim.simulate(spinning(4.0), stop_time=1.0, compiled=False)
    path = animate(run, tmp_path / "x.html")
    code = "player.go(0); player.playing = true; player.frame(player.last - 300); return player.t;"
    assert asked(path, code, tmp_path) == 0


def test_chart_shows_the_values_of_the_valid_part(tmp_path):
    pytest.importorskip("ziglang")
    path = animate(cosim.load("bicycle"), tmp_path / "x.html")
    code = f"""
        location.hash = "#speed=3&phi_dot=1"; // falls over; then the steer angle turns round
        await new Promise((done) => setTimeout(done, 50));
        {FRAMES}
        const [{{ curves, invalid_from }}] = player.results, [{{ plot }}] = player.curves.charts;
        const steer = player.data.columns.findIndex((column) => column.name === "delta");
        return [invalid_from, plot.scales.y.max, Math.max(...curves.values[steer]) * 180 / Math.PI];
    """
    since, shown, largest = asked(path, code, tmp_path)
    assert since == pytest.approx(4.48, abs=0.01)
    assert shown < 150 < 400 < largest


def phone(path, code, folder):
    """Return what JavaScript returns in a page on a phone."""
    pytest.importorskip("websockets")
    with opened(path, folder, (390, 844)) as page:
        page.call(
            "Emulation.setDeviceMetricsOverride",
            width=390,
            height=844,
            deviceScaleFactor=1,
            mobile=True,
        )
        page.call("Emulation.setTouchEmulationEnabled", enabled=True)
        return page.ask(FRAMES + code)


def test_message_on_a_phone_leaves_the_bodies_to_be_seen(tmp_path):
    run = cosim.simulate(spinning(4.0), stop_time=1.0, compiled=False)
    path = animate(run, tmp_path / "x.html")
    code = f"""
        const [box, view] = ["alarm", "view"].map((name) => document.getElementById(name));
        const before = view.offsetHeight;
        player.complaints = () => ["stopped at 1.68 s: the step from 1.68 to 1.69 came no further "
            + "than 1.68249; invalid: the rear wheel would lift off", "another one"];
        player.stale = true;
        {FRAMES}
        const covered = view.getBoundingClientRect().bottom - box.getBoundingClientRect().top;
        return [before, view.offsetHeight, covered, box.offsetHeight];
    """
    before, after, covered, height = phone(path, code, tmp_path)
    assert after == before == pytest.approx(0.42 * 844, abs=1)
    assert covered <= 0
    assert 44 <= height <= 0.3 * after  # it unfolds under a finger


def test_message_stands_below_the_picture_and_title_and_buttons_above_it(tmp_path):
    run = cosim.simulate(spinning(4.0, limit=2.0), stop_time=1.0, compiled=False)
    path = animate(run, tmp_path / "x.html")
    code = f"""
        player.go(0);
        {FRAMES}
        const [box, view] = ["alarm", "view"].map((name) => document.getElementById(name));
        const before = box.textContent, height = view.offsetHeight;
        player.go(0.9);
        {FRAMES}
        const button = document.getElementById("fit").getBoundingClientRect();
        const hit = document.elementFromPoint(button.left + 5, button.top + 5);
        return [before, box.textContent, view.offsetHeight - height, hit.id,
                box.getBoundingClientRect().top >= view.getBoundingClientRect().bottom,
                player.scene.canvas.height / window.devicePixelRatio === view.offsetHeight];
    """
    before, after, moved, hit, below, fits = asked(path, code, tmp_path)
    assert before == after == "invalid from 0.5 s: not fulfilled: the disk turns by less than 2 rad"
    assert (moved, hit, below, fits) == (0, "fit", True, True)


def test_message_of_a_page_without_bodies_does_not_cover_its_title(tmp_path):
    pytest.importorskip("ziglang")
    model = cosim.Model("decay", stop_time=1.0)
    x = model.state("x", "m", 1.0, "place")
    model.derivative(x, -x)
    path = animate(model.freeze(), tmp_path / "x.html")
    code = f"""
        player.complaints = () => ["invalid from 0 s: something"];
        player.stale = true;
        {FRAMES}
        const [title, box, chart] = ["facts", "alarm", "charts"].map(
            (name) => document.getElementById(name).getBoundingClientRect());
        return [title.bottom <= box.top, box.bottom <= chart.top];
    """
    assert asked(path, code, tmp_path) == [True, True]


def test_a_page_without_bodies_leaves_no_room_for_them_on_a_phone(tmp_path):
    pytest.importorskip("websockets")
    run = cosim.simulate(cosim.load("bar_on_frame"), stop_time=1.0, compiled=False)
    path = animate(replace(run, drawing=Drawing()), tmp_path / "x.html")
    with opened(path, tmp_path, (390, 844)) as page:
        height = page.ask("return document.getElementById('stage').offsetHeight")
    assert 0 < height < 84  # px, a tenth of the screen; measured 30


def test_numbers_and_units_of_sliders_fit(tmp_path):
    pytest.importorskip("ziglang")
    path = animate(cosim.load("bar_on_frame"), tmp_path / "x.html")
    code = """
        const pen = document.createElement("canvas").getContext("2d"), range = new Range();
        const texts = [-15.3333, -1.2345678e-5, 2.1e11, -0.00123456, -1.234567e-12].map(fitting);
        return [...document.querySelectorAll(".setting")].flatMap((line) => {
            const field = line.querySelector("input[type=number]"), unit = line.lastElementChild;
            const style = getComputedStyle(field);
            const arrows = style.appearance === "textfield" ? 0 : 16;
            pen.font = style.font;
            const room = field.clientWidth - 2 * parseFloat(style.paddingLeft) - arrows;
            range.selectNodeContents(unit);
            const beyond = range.getBoundingClientRect().right > unit.getBoundingClientRect().right;
            const cut = texts.some((text) => pen.measureText(text).width > room);
            return beyond || cut ? [line.textContent] : [];
        });
    """
    assert asked(path, code, tmp_path) == []


def test_field_without_a_number_shows_the_value_that_counts(tmp_path):
    pytest.importorskip("ziglang")
    path = animate(cosim.load("bar_on_frame"), tmp_path / "x.html")
    code = """
        const field = document.querySelector("input[type=number]"), before = field.value;
        field.value = "";
        field.dispatchEvent(new Event("change"));
        return [before, field.value];
    """
    before, after = asked(path, code, tmp_path)
    assert after == before != ""


def test_curves_that_coincide_are_all_seen(tmp_path):
    run = cosim.simulate("disk_two_bars", stop_time=1.0, compiled=False)
    path = animate(run, tmp_path / "x.html")
    code = "return player.curves.charts[0].plot.series.slice(1).map((line) => line.dash || []);"
    first, *others = asked(path, code, tmp_path)
    assert first == []
    gaps = [gap for _, gap in others]  # through which the curves below are seen
    assert gaps == sorted({*gaps, 5})


def test_legend_shows_the_values_of_the_present_time(tmp_path):
    run = cosim.simulate(spinning(4.0), stop_time=1.0, compiled=False)
    path = animate(run, tmp_path / "x.html")
    code = f"""
        player.go(player.end);
        {FRAMES}
        return document.querySelector(".u-legend .u-value").textContent;
    """
    assert asked(path, code, tmp_path) == "1 s"


def test_a_page_scales_arrows_as_a_picture_does(tmp_path):
    pytest.importorskip("ziglang")
    dae = cosim.load("bicycle")  # falls over: its forces have a peak shortly before
    page_of_falls = animate(dae, tmp_path / "x.html")
    scaled = "player.scene.actors[0].loads[0].load.per_unit"
    code = f"location.hash = '#phi_dot=2.5'; {FRAMES} return {scaled}"
    run = cosim.simulate(dae, start_values={"phi_dot": 2.5})
    expected = scale_of([playback(run, run.drawing, times=run.time)], None).per_unit["N"]
    assert asked(page_of_falls, code, tmp_path) == pytest.approx(expected, rel=1e-3)


def made_up(begin, span, values):
    """Return a run without bodies."""
    time = begin + span * np.linspace(0.0, 1.0, len(values))
    run = Trajectory("made up", time, (Column("a", "1"),), np.array(values, dtype=float)[:, None])
    return replace(run, drawing=Drawing())


@pytest.mark.parametrize(
    ("begin", "span", "now", "legend", "first"),
    [
        (0.0, 1e-9, "5.0000e-10 s", "5e-10 s", ["0", "1e-10", "2e-10"]),
        (0.0, 1e-3, "0.000500 s", "0.0005 s", ["0", "0.0001", "0.0002"]),
        (0.0, 20.0, "10.00 s", "10 s", ["0", "1", "2"]),
        (1e9, 1.0, "1000000000.50 s", "1000000000.5 s", ["1000000000", "1000000000.1"]),
    ],
)
def test_times_of_a_page_can_be_told_apart(begin, span, now, legend, first, tmp_path):
    path = animate(made_up(begin, span, [0, 1, 0]), tmp_path / "x.html")
    code = f"""
        player.go(player.begin + {span} / 2);
        {FRAMES}
        const [x] = player.curves.charts[0].plot.axes, size = 14 * x._values.length;
        return [document.getElementById("now").textContent, x._values,
                document.querySelector(".u-legend .u-value").textContent];
    """
    shown, ticks, beside = asked(path, code, tmp_path)
    assert (shown, beside) == (now, legend)
    ticks = [tick for tick in ticks if tick]
    assert len(set(ticks)) == len(ticks) > 3
    assert {*first} <= {*ticks}


@pytest.mark.parametrize(
    ("values", "low", "high"),
    [
        ([1e-30, -1e-30], -1.2e-30, 1.2e-30),
        ([1000.0, 1000.2], 999.98, 1000.22),
        ([5.0, 5.0 + 1e-12], 4.5, 5.5),
        ([0.0, 0.0], -1, 1),
        ([0.5], 0.45, 0.55),
    ],
)
def test_charts_fit_values_of_any_size(values, low, high, tmp_path):
    path = animate(made_up(0.0, 1.0, values), tmp_path / "x.html")
    code = f"""
        {FRAMES}
        const [{{ plot }}] = player.curves.charts, {{ scales, axes, series }} = plot;
        return [scales.y.min, scales.y.max, axes[1]._values, series[1].points.show];
    """
    *found, ticks, points = asked(path, code, tmp_path)
    assert found == pytest.approx([low, high], rel=1e-6)
    assert len(set(ticks)) == len(ticks)
    assert bool(points) is (len(values) == 1)


def test_an_event_at_the_end_of_a_run_is_named(tmp_path):
    """Times of frames are floats of 4 bytes, which may lie before it."""
    model = cosim.Model("ball", stop_time=1.0)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    bounces = model.discrete("bounces", "1", 0, "number of impacts")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -0.7 * v, bounces: bounces + 1}, name="impact")
    model.stop(bounces > 0, "it has bounced")
    run = cosim.simulate(model.freeze(), record_events=True)
    path = animate(run, tmp_path / "x.html")
    code = f"player.go(player.end); {FRAMES} return document.getElementById('facts').textContent"
    assert "impact" in asked(path, code, tmp_path)
