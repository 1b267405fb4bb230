"""The command line for people: the book's numbers, units, times, stops, hints, a start."""

import argparse
import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import cosim
import cosim.cli
from cosim.cli.main import command_line, main
from cosim.cli.options import seconds
from cosim.cli.tables import show_table
from cosim.cli.verbs import VERBS
from cosim.cli.verbs.export import _options


def numbers(capsys, line):
    """Return the last column of the table that a command prints, by name, and the units."""
    assert main(line.split()) == 0
    _, *rows = capsys.readouterr().out.splitlines()
    cells = [row.split() for row in rows]
    return {c[0]: float(c[-1]) for c in cells}, {c[0]: c[1] for c in cells}


# -- the book's printed numbers, each out of one command (docs/command_line.md) -------------------

BOOK = [
    (
        "crank_shaft --at 0 --units book --outputs fx_A,fy_A,T",
        {"fx_A": "-6.4994", "fy_A": "0.025998", "T": "0.086659"},
        {"fx_A": "lbf", "fy_A": "lbf", "T": "ft.lbf"},
    ),
    ("bar_on_frame.toml --at 10 --units book --outputs tk_G_F", {"tk_G_F": "0.01666"}, {}),
    ("bicycle_model_2.toml --at 20 --units book --outputs psi", {"psi": "13.65"}, {"psi": "deg"}),
    (
        "disk_two_bars.toml --at 20 --units book --outputs theta1,theta2",
        {"theta1": "20.37", "theta2": "52.77"},
        {"theta1": "deg", "theta2": "deg"},
    ),
]


@pytest.mark.slow_rows("bicycle_model_2.toml --at 20 --units book --outputs psi")
@pytest.mark.parametrize(("line", "printed", "units"), BOOK, ids=[line[0] for line in BOOK])
def test_printed_number_comes_out_of_one_command(line, printed, units, capsys):
    found, own = numbers(capsys, f"simulate {line}")
    for name, text in printed.items():
        digits = len(text.lstrip("-0.").replace(".", ""))
        assert f"{found[name]:.{digits}g}" == text
    assert own.items() >= units.items()


# -- units, times, inputs, stops ------------------------------------------------------------------

INTERPRETED = ("--backend", "native-interpreted")
SHORT = ("--stop-time", "20ms", *INTERPRETED)


def test_file_in_the_book_s_units_names_them_in_its_second_line(tmp_path, capsys):
    target = tmp_path / "a.csv"
    line = ["simulate", "crank_shaft", *SHORT, "--outputs", "phi,omega", "-o", str(target)]
    assert main([*line, "--units", "book"]) == 0
    assert target.read_text().splitlines()[:2] == ["time,phi,omega", "s,deg,rpm"]
    run = cosim.Trajectory.read_csv(target)
    assert main(line) == 0
    np.testing.assert_allclose(run.values, cosim.Trajectory.read_csv(target).values, rtol=1e-15)
    assert main([*line, "--units", "imperial"]) == 3
    assert "no kind of units 'imperial'; it has si, book" in capsys.readouterr().err


@pytest.mark.slow
def test_accuracy_may_have_the_unit_of_the_outputs(tmp_path, capsys):
    line = ["simulate", "crank_shaft", "--outputs", "phi", "--stop-time", "0.2"]
    line += ["-o", str(tmp_path / "a.csv")]
    assert main([*line, "--accuracy", "1 deg"]) == 0
    by_unit = capsys.readouterr().err
    nominal = cosim.load("crank_shaft").variable("phi").nominal
    assert main([*line, "--accuracy", str(np.radians(1) / nominal)]) == 0
    assert capsys.readouterr().err.split(";")[0] == by_unit.split(";")[0]


@pytest.mark.slow
def test_values_along_a_parameter_may_have_a_unit(capsys):
    line = ["linearize", "bicycle", "--equilibrium", "-q", "--along"]
    tables = []
    for span in ("speed = 8 mph : 10 mph : 3", "speed=3.57632:4.4704:3"):
        assert main([*line, span]) == 0
        tables.append(capsys.readouterr().out)
    assert tables[0] == tables[1]
    assert "4.292" in tables[0]
    assert main([*line, "speed=8kg:10kg:3"]) == 2
    assert "'kg' cannot be converted to 'm/s'" in capsys.readouterr().err


def test_terminal_shows_a_summary_and_a_pipe_receives_every_row(monkeypatch, capsys):
    line = ["simulate", "crank_shaft", *SHORT, "--outputs", "phi"]
    assert main(line) == 0
    assert capsys.readouterr().out.startswith("time,phi\n0,")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    assert main(line) == 0
    printed = capsys.readouterr()
    assert "min at [s]" in printed.out
    assert len(printed.out.splitlines()) == 3
    assert "every output time: -o FILE.csv" in printed.err


@pytest.mark.slow
def test_inputs_come_as_formulas_and_files_and_runs_stop(tmp_path, capsys):
    (tmp_path / "torque.csv").write_text("time,steer_torque\n0,0\n1,1\n")
    outputs = ["--outputs", "phi", *INTERPRETED, "--at", "0.5"]
    found = {}
    for name, words in {
        "formula": ["--input", "steer_torque = t"],
        "file": ["--input-file", str(tmp_path / "torque.csv")],
        "none": [],
    }.items():
        assert main(["simulate", "bicycle", *words, *outputs]) == 0
        found[name] = float(capsys.readouterr().out.split()[-1])
    assert found["formula"] == pytest.approx(found["file"], rel=1e-6)
    assert abs(found["none"] - found["file"]) > 1e-3
    line = ["simulate", "crank_shaft", "--stop-when", "phi > 360deg", *INTERPRETED, "--json"]
    assert main(line) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["values"]["phi"][-1] == pytest.approx(2 * np.pi, rel=1e-7)
    assert printed.err.startswith("stopped where phi > 360deg from 0.1241")


@pytest.mark.slow_rows("ode45-erk")
@pytest.mark.parametrize(
    ("alias", "name"), [("ode45", "erk"), ("ode15s", "cvodes"), ("ode4", "rk4")]
)
def test_solvers_also_have_the_names_of_matlab(alias, name, capsys):
    assert main(["simulate", "crank_shaft", *SHORT, "--solver", alias, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["stats"]["solver"] == name
    assert cosim.simulate("crank_shaft", stop_time=0.1, solver=alias).stats.solver == name


@pytest.mark.parametrize(("text", "value"), [("5", 5.0), ("5s", 5), ("200 ms", 0.2), ("2min", 120)])
def test_times_may_have_a_unit(text, value):
    assert seconds(text) == pytest.approx(value, rel=1e-15)
    with pytest.raises(argparse.ArgumentTypeError, match="invalid float value: '5m'"):
        seconds("5m")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("simlate bicycle", "did you mean simulate?"),
        ("s bicycle", "several verbs begin with 's': simulate, sweep, sensitivity;"),
        ("simulate bicycle --stoptime 3", "did you mean --stop-time?"),
        ("simulate bicycle --input t", "--input t: write NAME=FORMULA"),
        ("simulate bicycle --input steer=t", "no input 'steer'; did you mean steer_torque?"),
        ("simulate bicycle --at soon", "--at: 'soon' is not a number with a unit"),
        ("scene bicycle_modell_1", "did you mean bicycle_model_1"),
        ("new pendulum.txt", "use letters, digits and _, as in pendulum.py"),
        ("new mine.toml", "add --from SCENE"),
        ("new mine.py --from crank_torque", "give a name like mine.toml"),
        ("--print-completion csh", "no shell 'csh'; did you mean tcsh?"),
    ],
)
def test_unknown_words_are_reported_with_the_nearest_name(line, expected, capsys):
    try:
        code = main(line.split())
    except SystemExit as end:  # of argparse
        code = end.code
    assert code in (2, 3)
    assert expected in capsys.readouterr().err


# -- to start from --------------------------------------------------------------------------------


def test_new_model_runs_and_is_not_overwritten(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "swing.py"]) == 0
    assert "cosim simulate swing.py:build" in capsys.readouterr().err
    run = cosim.simulate("swing.py:build", compiled=False)
    assert run.complete
    assert run["energy"][-1] < run["energy"][0]  # damped
    assert main(["new", "swing.py"]) == 2
    assert "swing.py exists" in capsys.readouterr().err


def test_scene_is_printed_as_it_is_shipped(tmp_path, capsys):
    assert main(["scene", "crank_torque"]) == 0
    (tmp_path / "mine.toml").write_text(capsys.readouterr().out)
    assert cosim.read_scene(tmp_path / "mine.toml").title == "Drive torque of the crank shaft"


def test_shipped_scene_is_copied_to_a_new_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine.toml", "--from", "crank_torque"]) == 0
    assert "cosim simulate mine.toml" in capsys.readouterr().err
    assert cosim.read_scene("mine.toml").title == "Drive torque of the crank shaft"
    assert main(["new", "mine.toml", "--from", "crank_torque"]) == 2
    assert "mine.toml exists" in capsys.readouterr().err


@pytest.mark.slow
def test_plot_of_a_result_draws_the_outputs_that_are_named(tmp_path, capsys):
    result, picture = tmp_path / "bicycle.csv", tmp_path / "phi.png"
    assert main(["simulate", "bicycle", "--stop-time", "0.1", "-q", "-o", str(result)]) == 0
    assert main(["plot", str(result), "--outputs", "phi", "-o", str(picture), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(picture)]  # all take two pages


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    ["animate crank_shaft --at 0 -o x.png", "new x.py", "report crank_torque.toml -o x.html"],
)
def test_verb_that_writes_a_file_reports_it_as_json(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = line.split()
    short = [] if words[0] == "new" else ["--stop-time", "0.1", *INTERPRETED]
    extra = ["--no-crosscheck"] if words[0] == "report" else []
    assert main([*words, *short, *extra, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [words[-1]]


def test_sweep_prints_its_table_as_json(capsys):
    line = "sweep crank_shaft -p omega=40,50 --stop-time 0.1 --outputs phi --workers 0 --json -q"
    assert main(line.split()) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["omega"] for row in rows] == [40.0, 50.0]
    assert [row["phi_final"] for row in rows] == pytest.approx([4.05, 5.05])  # 10 t^2 / 2 + omega t


@pytest.mark.slow
def test_export_and_plot_report_written_files_as_json(tmp_path, capsys):
    picture = tmp_path / "a.png"
    assert main(["plot", "crank_torque.toml", "-o", str(picture), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(picture)]
    fmu = tmp_path / "a.fmu"
    assert main(["export", "crank_torque.toml", "-o", str(fmu), "--json", "-q"]) == 0
    assert json.loads(capsys.readouterr().out)["bytes"] == fmu.stat().st_size


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_names_verbs_and_options(shell, capsys):
    with pytest.raises(SystemExit) as end:
        main(["--print-completion", shell])
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert "crosscheck" in text
    assert "stop-when" in text
    assert "what to do" not in command_line().format_help()  # of the script alone
    if shell == "bash":
        check = subprocess.run(
            ["bash", "-n"], input=text, text=True, capture_output=True, check=False
        )
        assert check.stderr == ""


def test_verdicts_are_colored_on_a_terminal_unless_no_color_is_set(monkeypatch, capsys):
    rows = [{"backend": "fmpy", "verdict": "ok"}, {"backend": "ok", "verdict": "DIFFERS"}]
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    show_table(rows, as_json=False)
    assert "\x1b" not in capsys.readouterr().out
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    show_table(rows, as_json=False)
    assert "\x1b[31mDIFFERS\x1b[0m" in capsys.readouterr().out
    monkeypatch.setenv("NO_COLOR", "1")
    show_table(rows, as_json=False)
    assert "\x1b" not in capsys.readouterr().out


def test_times_far_from_0_have_columns_of_their_own(capsys):
    line = ["simulate", "crank_shaft", "--start-time", "10000000000", "--outputs", "phi", "-q"]
    assert main([*line, "--at", "10000000001,10000000002"]) == 0
    head, row = capsys.readouterr().out.splitlines()
    assert head.split() == ["name", "unit", "10000000001", "s", "10000000002", "s"]
    assert [float(word) for word in row.split()[2:]] == pytest.approx([55, 120])  # 50 t + 5 t^2


RAMP = """
import cosim

def build():
    model = cosim.Model("ramp", stop_time=2.0)
    x = model.state("x", "m", 0.0, "place")
    model.derivative(x, 1.0)
    model.stop(x > 1.25, "reached")
    return model.freeze()

def ball():
    model = cosim.Model("ball", stop_time=2.0)
    x, v = model.state("x", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -9.81)
    model.when(x < 0, {v: -v / 2})  # ever faster before 1.355 s
    return model.freeze()
"""


@pytest.mark.parametrize("where", ["native", "fmu-me", "fmu-cs"])
def test_table_of_a_run_that_stops_has_the_times_that_it_reached(
    where, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("ramp.py").write_text(RAMP, encoding="utf-8")
    line = ["simulate", "ramp.py:build", "--backend", where, "-q"]
    assert main([*line, "--at", "0.5,1,2"]) == 0
    head, row = capsys.readouterr().out.splitlines()
    assert [round(float(word), 9) for word in head.split()[2::2]] == [0.5, 1.0, 1.25]
    assert [float(word) for word in row.split()[2:]] == pytest.approx([0.5, 1.0, 1.25])
    assert main([*line, "--start-time", "0.5", "--at=0,2"]) == 2  # no time of the run
    capsys.readouterr()


def test_table_of_a_coupled_run_that_fails_has_the_times_that_it_reached(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("ramp.py").write_text(RAMP, encoding="utf-8")
    Path("pair.toml").write_text(
        'stop_time = 2.0\n[parts]\na = "ramp.py:ball"\nb = "ramp.py:ball"\n', encoding="utf-8"
    )
    assert main(["simulate", "pair.toml", "--method", "iterated", "--at", "0.5,2", "-q"]) == 1
    captured = capsys.readouterr()
    assert captured.out.splitlines()[0].split() == ["name", "unit", "0.5", "s"]
    assert "ParameterError" not in captured.err


def test_beginning_of_a_verb_is_enough_if_it_is_the_only_one(capsys):
    assert main(["sim", "crank_shaft", "--at", "0", "-q"]) == 0
    assert "omega" in capsys.readouterr().out
    with pytest.raises(SystemExit) as stopped:
        main(["s", "crank_shaft"])
    assert stopped.value.code == 2


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_no_help_shows_a_hidden_option(verb):
    assert argparse.SUPPRESS not in command_line().verbs()[verb].format_help()


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_no_verb_offers_an_option_that_it_does_not_read(verb):
    folder = Path(cosim.cli.__file__).parent
    own = (folder / "verbs" / f"{verb}.py").read_text()
    shared = "".join(path.read_text() for path in folder.glob("*.py"))
    actions = command_line().verbs()[verb]._actions
    names = {a.dest for a in actions if a.help != argparse.SUPPRESS}
    names -= {"help", "info"}  # `cosim cache --info` is its default
    unread = [n for n in sorted(names) if not re.search(rf'(args\.|"){n}\b', own + shared)]
    assert unread == []


def test_versions_of_fmi_are_written_as_the_standard_does_too():
    args = [
        command_line().parse_args(["export", "bicycle", "--fmi", text]) for text in ("3.0", "3")
    ]
    assert [_options(each, "bicycle")["fmi"] for each in args] == [3, 3]


def test_cost_of_a_run_is_printed_with_four_digits(capsys, tmp_path):
    words = ["simulate", "crank_shaft", *SHORT, "-v", "-o", str(tmp_path / "a.csv")]
    assert main(words) == 0
    printed = capsys.readouterr().err
    assert re.search(r"solve_time [\d.e-]+, ", printed)
    assert not re.search(r"[1-9]\d{4}", printed)
