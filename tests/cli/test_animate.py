"""`cosim animate`: sources, ghosts, and how it ends."""

import sys

import pytest

from cosim.cli.main import main


def animate(*words):
    return main(["animate", *map(str, words), "-q"])


@pytest.mark.slow
def test_scene_is_shown_with_everything_that_its_bodies_need(tmp_path):
    target = tmp_path / "x.png"
    assert animate("bicycle_front_contact.toml", "--stop-time", "0.5", "-o", target) == 0
    assert target.stat().st_size > 10_000


@pytest.mark.slow
def test_result_in_a_file_is_recognized(tmp_path, capsys):
    table, target = tmp_path / "run.csv", tmp_path / "x.png"
    assert main(["simulate", "crank_shaft", "--stop-time", "0.5", "--output-file", str(table)]) == 0
    assert main(["animate", str(table), "-o", str(target), "--at", "0,0.1"]) == 0
    assert "the result is drawn as crank_shaft" in capsys.readouterr().err
    assert target.exists()


@pytest.mark.slow
def test_fmu_is_shown_by_the_model_that_it_is_named_after(tmp_path):
    fmu, target = tmp_path / "crank.fmu", tmp_path / "x.png"
    assert main(["export", "crank_shaft", "-o", str(fmu), "-q"]) == 0
    assert animate(fmu, "--stop-time", "0.5", "-o", target) == 0
    assert target.exists()


@pytest.mark.slow
def test_several_values_and_formulations_are_ghosts(tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr(
        "cosim.cli.verbs.animate.animate",
        lambda runs, *_, **__: shown.extend(runs) or tmp_path / "x",
    )
    values = ("-p", "thetaR_dot=-12,-14,-16", "--stop-time", "0.1")
    assert animate("bicycle", *values, "-o", tmp_path / "x.html") == 0
    assert [run["thetaR_dot"][0] for run in shown] == [-12.0, -14.0, -16.0]
    assert [run.stats["variation"] for run in shown] == [
        f"thetaR_dot={value} rad/s" for value in (-12, -14, -16)
    ]
    shown.clear()
    backends = ("--compare", "multipliers,book", "--stop-time", "0.1")
    assert animate("bicycle", *backends, "-o", tmp_path / "x.html") == 0
    assert [run.model for run in shown] == [f"bicycle/{f}" for f in
                                            ("independent", "multipliers", "book")]  # fmt: skip


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (["bicycle", "-o", "x.foo"], 3, "no animation format 'foo'"),
        (["bicykle", "-o", "x.png"], 3, "did you mean bicycle?"),
        (["bicycle", "-o", "x.png", "--size", "big"], 2, "write WIDTHxHEIGHT in inches"),
        (["bicycle", "-o", "x.png", "--at", "soon"], 2, "--at: 'soon' is not a number"),
        (
            ["bicycle_steer_kick.toml", "--live", "--start-time", "1", "-o", "x.html"],
            2,
            "a page that computes begins at 0: set --start-time to 0",
        ),
        (["nothing.csv", "-o", "x.png"], 2, "nothing.csv is no result of a run"),
        (["bicycle", "-o", "nowhere/x.png"], 1, "create nowhere first"),
    ],
)
def test_wrong_options_exit_with_their_code(words, code, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert animate(*words) == code
    assert expected in capsys.readouterr().err


def test_a_page_that_computes_says_that_its_times_begin_at_0(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("cosim.cli.verbs.animate.animate", lambda *_, **__: tmp_path / "x.html")
    words = ["animate", "crank_shaft", "--live", "--start-time", "1", "-o", "x.html"]
    assert main(words) == 0
    expected = "crank_shaft begins at 1 s; the times of a page that computes begin at 0"
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(("package", "kind"), [("meshcat", "html"), ("imageio_ffmpeg", "mp4")])
def test_missing_extra_ends_with_5_before_the_run(package, kind, capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delattr("cosim.cli.verbs.animate.runs_of")
    code = animate("crank_shaft", "--stop-time", "0.1", "-o", tmp_path / f"x.{kind}")
    assert code == 5
    assert 'pip install "cosim-rigid[animate]"' in capsys.readouterr().err


def test_times_of_the_poses_are_not_those_of_the_run(monkeypatch, tmp_path):
    """A trace is the whole path, not straight lines from pose to pose."""
    shown = []
    target = "cosim.cli.verbs.animate.animate"
    monkeypatch.setattr(target, lambda runs, *_, **__: shown.extend(runs) or tmp_path / "x")
    options = ("--stop-time", "0.2", "--at", "0,0.1", "-o", str(tmp_path / "x.png"))
    assert main(["animate", "crank_shaft/driven", *options]) == 0
    assert len(shown[0].time) == 21
