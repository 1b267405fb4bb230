"""`cosim report`: one page that says what ran, what came out and how far it can be trusted."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import spinning

import cosim
from casadi_models.dae import Model
from cosim.cli.main import main
from cosim.present.report import ReportContents, printed_rows, report


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    target = tmp_path_factory.mktemp("report") / "x.html"
    assert main(["report", "crank_shaft.toml", "-o", str(target), "-q"]) == 0
    return target.read_text(encoding="utf-8")


def without_playback(page):
    return re.sub(r'srcdoc="[^"]*"', "", page)


@pytest.mark.slow
def test_report_holds_every_part(page):
    for i, part in enumerate(
        ("The system", "In motion", "Numbers", "The book's numbers", "Figures",
         "Accuracy", "Reproduction")
    ):  # fmt: skip
        assert f'<h2 id="{i}">{part}' in page
        assert f'<a href="#{i}">{part}' in page
    text = without_playback(page)
    for fact in ("Unit 7, Example 1", "seven welded slender bars", "<b>Model</b>: bars slender",
                 "phi, omega", "477.46483",
                 "6.4994176", "fmu-me", "crank_shaft/multipliers", "SHA-256",
                 "cosim report crank_shaft.toml"):  # fmt: skip
        assert fact in text
    assert text.count("<svg") == 1 + 3  # the pose and the scene's figures


@pytest.mark.slow
def test_report_is_one_file_without_the_network(page):
    text = without_playback(page)
    addresses = set(re.findall(r'(?:src|href)="(https?:[^"]*)"', text))
    assert not addresses
    assert "@media print" in text


@pytest.mark.slow
def test_report_is_well_formed(page):
    class Tags(HTMLParser):
        def __init__(self):
            super().__init__()
            self.open = []

        def handle_starttag(self, tag, attributes):
            if tag not in ("meta", "br", "img"):
                self.open.append(tag)

        def handle_endtag(self, tag):
            assert self.open.pop() == tag

        def handle_startendtag(self, tag, attributes):
            pass

    parser = Tags()
    parser.feed(without_playback(page).replace("<?xml", "<!--").replace("?>", "-->"))
    assert not parser.open


@pytest.mark.slow_rows("bicycle_model_1.toml")
@pytest.mark.parametrize("name", ["crank_shaft.toml", "bar_on_frame.toml", "bicycle_model_1.toml"])
def test_printed_numbers_are_met_as_far_as_they_were_printed(name):
    scene = cosim.read_scene(name)
    scene = cosim.Scene(scene.name, replace(scene.request, outputs=None), scene.title)
    rows = list(printed_rows(scene, cosim.run_scene(scene)))
    assert len(rows) >= 3
    assert [row["variable"] for row in rows if row["differs"] != "no"] == []


def test_printed_numbers_are_left_out_where_values_were_changed():
    scene = cosim.read_scene("crank_shaft.toml")
    request = replace(scene.request, values={**scene.request.values, "alpha": 11.0})
    changed = replace(scene, request=request)
    assert not list(printed_rows(changed, cosim.run_scene(changed)))


def test_printed_number_that_is_not_met_is_marked():
    scene = cosim.read_scene("crank_shaft.toml")
    run = cosim.run_scene(scene)
    wrong = replace(run, values=run.values * 1.001)
    rows = list(printed_rows(scene, wrong))
    assert {row["differs"].partition(",")[0] for row in rows} == {"yes"}


def report_of(dae):
    run = cosim.simulate(dae, stop_time=1.0, compiled=False)
    scene = cosim.Scene("x", cosim.requested(dae))
    return report(ReportContents(scene, dae, run, None, [], "cosim report x"))


def test_invalid_run_is_called_so_at_the_top():
    dae = spinning(4.0, limit=2.0)
    page = report_of(dae)
    head = page[: page.index("<h2 ")]
    assert "invalid from 0.5 s: not fulfilled" in head
    assert "shaded: invalid from" in page


def test_every_reason_of_invalidity_has_its_time():
    dae = spinning(4.0, limit=2.0)
    dae = replace(dae, limits=(*dae.limits, (3.0 - dae.x[0], "the angle is less than 3 rad")))
    page = report_of(dae)
    head = page[: page.index("<h2 ")]
    assert "invalid from 0.5 s: not fulfilled: the disk turns by less than 2 rad; not" in head
    assert "not fulfilled: the angle is less than 3 rad (from 0.75 s)" in head


@pytest.mark.slow
def test_report_of_a_large_model_has_linear_equations():
    dae = cosim.load("bicycle")
    run = cosim.simulate(dae, stop_time=0.1, compiled=False)
    scene = cosim.Scene("x", cosim.requested(dae))
    page = report(ReportContents(scene, dae, run, None, [], "cosim report bicycle"))
    linear = page[page.index("<h3>Linear equations") : page.index("The model is valid while")]
    assert "1 step of Newton" in linear
    assert "phi_dot = 0 rad/s instead of 0.5" in linear
    assert linear.count(" operations)") == 0
    assert "<td>theta</td><td>0</td>" in page  # calculated, but for rounding
    assert "in stages (<code>stages</code>" in page
    for formulation in ("independent", "book", "multipliers"):
        assert f"<b>{formulation}</b>: " in page


def test_report_shows_the_time_series_of_an_input_and_its_value_at_the_start():
    model = Model("pushed", stop_time=1.0)
    x, u = model.state("x", "1", 0.0, "place"), model.input("u", "1", 0.0, "push")
    factor = x
    for _ in range(200):
        factor = ca.sin(factor) + 0.1
    model.derivative(x, u + x**2 * ca.exp(factor))  # too large to be printed, and never 0
    series = cosim.InputSeries(("u",), np.array([0.0, 10.0]), np.array([[0.0], [10.0]]))
    request = cosim.requested(model.freeze(), inputs=series, start_time=3.0, stop_time=3.01)
    run = cosim.simulate(request.dae, inputs=series, start_time=3.0, stop_time=3.01, compiled=False)
    contents = ReportContents(cosim.Scene("x", request), request.dae, run, None, [], "")
    page = report(contents)
    linear = page[page.index("<h3>Linear equations") : page.index("<h2 id=", page.index("<h3>Lin"))]
    assert re.findall("<mn>(.*?)</mn>", linear)[:1] == ["3"]  # dx/dt = 3 + ...
    assert "<td>u</td><td></td><td>1</td><td>push (a time series)</td>" in page


def test_command_of_a_report_holds_no_absolute_path(tmp_path):
    own = tmp_path / "own.py"
    assert main(["new", str(own), "-q"]) == 0
    target = tmp_path / "x.html"
    words = ["report", f"{own}:build", "-o", str(target), "--no-crosscheck", "--stop-time", "0.1"]
    assert main([*words, "-q"]) == 0  # however the command was started, as by `python -m cosim`
    text = without_playback(target.read_text(encoding="utf-8"))
    assert "cosim report own.py:build -o x.html --no-crosscheck --stop-time 0.1 -q</td>" in text
    assert str(tmp_path) not in text


def test_report_of_something_else_is_refused(capsys):
    assert main(["report", "bicycle", "-o", "x.pdf"]) == 3
    assert main(["report", "x.fmu", "-o", "x.html"]) == 2
    assert "plot an FMU with: cosim plot" in capsys.readouterr().err


@pytest.mark.slow
def test_report_fits_a_phone_and_a_dark_screen_and_shows_the_equations(page):
    text = without_playback(page)
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in text
    assert "prefers-color-scheme: dark" in text
    equations = text[text.index("<h3>Equations") : text.index("<h3>Outputs")]
    assert equations.count("<math") == 2  # d phi / dt = omega, d omega / dt = alpha
    assert "<h3>Linear" not in text  # all equations are printed
    assert "svg, img { filter: invert" in text  # white paper would dazzle
    assert '<div class="paper"><figure>' in text  # on the screen, the playback shows it
