"""Inputs of coupled systems follow formulas and tables, as those of one model do."""

from itertools import pairwise
from time import process_time

import numpy as np
import pytest
from scipy.linalg import expm

import cosim
from cosim.cli.main import main
from cosim.errors import ParameterError, UnknownName, UsageError

TABLE = np.array([0.0, 1.0, 1.0, 2.0, 3.0]), np.array([0.0, 0.0, 2.0, 1.0, 1.0])  # s, N


def mass(name):
    """Return a mass of 1 kg on a spring of 1 N/m, with two forces."""
    model = cosim.Model(name)
    x, v = model.state("x", "m", 1, "place"), model.state("v", "m/s", 0, "speed")
    forces = model.input("force", "N", 0, "force"), model.input("kick", "N", 0, "another force")
    model.derivative(x, v)
    model.derivative(v, sum(forces))
    model.output("pull", "N", -x, "spring force")
    return model.freeze()


@pytest.fixture(scope="module")
def pair():
    """Two masses on each other's springs: x'' = -x + kick for equal kicks."""
    return cosim.couple(
        {"a": mass("a"), "b": mass("b")}, {"a.force": "b.pull", "b.force": "a.pull"}, name="pair"
    )


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """The same as a file whose part a is an FMU."""
    folder = tmp_path_factory.mktemp("pair")
    cosim.export_fmu(mass("a"), folder / "a.fmu")
    text = [
        *("import cosim", "def mass():", "    model = cosim.Model('b')"),
        "    x, v = model.state('x', 'm', 1, 'place'), model.state('v', 'm/s', 0, 'speed')",
        "    f, k = model.input('force', 'N', 0, 'force'), model.input('kick', 'N', 0, 'other')",
        "    model.derivative(x, v), model.derivative(v, f + k)",
        "    model.output('pull', 'N', -x, 'spring force')",
        "    return model.freeze()",
    ]
    (folder / "b.py").write_text("\n".join(text))
    wires = '"a.force" = "b.pull"\n"b.force" = "a.pull"\n'
    parts = 'a = "a.fmu"\nb = "b.py:mass"\n'
    (folder / "pair.toml").write_text(f"stop_time = 3\n[parts]\n{parts}[connections]\n{wires}")
    return folder / "pair.toml"


def table(name):
    return cosim.InputSeries((name,), TABLE[0], TABLE[1][:, None])


@pytest.mark.slow_rows("formula", "jump", "samples", "constant of a formula", "function", "table")
@pytest.mark.parametrize(
    "law",
    [
        "sin(3*t)",
        "where(t > 1, 1, 0)",  # a jump is an event
        ("k*t", {"k": 2.0}),
        lambda t: t**2,
        np.linspace(0, 1, 31),
        table("a.kick"),
        2.0,
    ],
    ids=["formula", "jump", "constant of a formula", "function", "samples", "table", "number"],
)
def test_co_simulation_is_as_the_one_model(pair, law):
    options = {"inputs": {"a.kick": law}, "stop_time": 3, "output_interval": 0.1}
    run = pair.simulate(accuracy=1e-7, **options)
    one = cosim.simulate(pair.dae, solver="dop853", relative_tolerance=1e-11, **options)
    assert np.abs(run["a.x"] - one["a.x"]).max() < 1e-7  # measured 1e-9
    assert run.stats["undriven_inputs"] == ["b.kick"]
    assert not [name for name in run.names if name.startswith("inputs")]


def test_equal_kicks_have_a_closed_form(pair):
    """x'' = -x + 2 t from x = 1: x = cos t + 2 (t - sin t)."""
    run = pair.simulate(inputs={"a.kick": "2*t", "b.kick": "2*t"}, stop_time=3, accuracy=1e-8)
    right = np.cos(run.time) + 2 * (run.time - np.sin(run.time))
    assert np.abs(run["b.x"] - right).max() < 1e-8


def recorded(rows, jumps=0):
    """Return two noisy signals with uneven times, some of which stand twice."""
    random = np.random.default_rng(4)
    time = np.sort(np.append(random.uniform(0, 3, rows - 2 - jumps), [0, 3]))
    time = np.sort(np.append(time, random.choice(time[1:-1], jumps, replace=False)))
    time[-1] = 3.2  # the run ends before it
    values = np.sin(5 * time)[:, None] * [1, -2] + random.normal(size=(rows, 2)) / 5
    values[rows // 2 : rows // 2 + 9] = 0.5  # at rest for a while
    return cosim.InputSeries(("a.kick", "b.kick"), time, values)


def from_row_to_row(series, times):
    """Return x of both masses: between two rows a linear system with a linear force."""
    law = np.array([[0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1], [-1, 0, 0, 0]])
    every, found = np.zeros((8, 8)), []
    every[:4, :4], every[1, 4], every[3, 5] = law, 1, 1
    every[4, 6] = every[5, 7] = 1  # forces grow by their slopes
    state, ends = np.array([1.0, 0, 1, 0]), np.union1d(times, series.time[series.time < times[-1]])
    for begin, end in pairwise([0, *ends]):
        force = series.at([begin])[:, 0]
        slope = (series.before([end])[:, 0] - force) / (end - begin) if end > begin else [0, 0]
        state = (expm(every * (end - begin)) @ np.concatenate((state, force, slope)))[:4]
        if end in times:
            found.append(state[[0, 2]])
    return np.array(found).T


@pytest.mark.parametrize(("rows", "jumps"), [(2, 0), (4, 1), (64, 5), (600, 60)])
@pytest.mark.parametrize(
    "how",
    [{"accuracy": 1e-6}, {"macro_step": 0.05}, {"macro_step": 0.05, "method": "extrapolated"}],
)
def test_recorded_signals_give_what_their_lines_do(pair, rows, jumps, how):
    series = recorded(rows, jumps)
    run = pair.simulate(inputs=series, stop_time=3, output_interval=0.25, **how)
    right = from_row_to_row(series, run.time)
    bound = how.get("accuracy", 0.05**4)
    assert np.abs([run["a.x"], run["b.x"]] - right).max() < bound  # measured 1.2e-6
    assert "note" not in run.stats


def test_rows_between_equal_ones_end_no_macro_step(pair):
    time = np.linspace(0, 3, 1501)
    kick = np.where(time > 1, 1.0, 0.0)[:, None]  # rises within 2 ms
    run = pair.simulate(
        inputs=cosim.InputSeries(("a.kick",), time, kick), stop_time=3, macro_step=0.1
    )
    assert run.stats["macro_steps"] == 31  # two ends more; 1 s is one of the others


def test_time_of_a_run_is_that_of_its_macro_steps_however_many_rows_a_table_has(pair):
    spent = []
    for rows in (100, 2000):
        begin = process_time()
        run = pair.simulate(inputs=recorded(rows), stop_time=3, macro_step=0.05)
        spent.append((process_time() - begin) / run.stats["macro_steps"])
    assert spent[1] < spent[0]  # with the time of the export; measured 5 ms and 0.5 ms


@pytest.mark.slow
def test_command_line_takes_formulas_and_tables_with_an_fmu(file, pair, tmp_path, capsys):
    rows = "".join(f"{t},{u}\n" for t, u in zip(*TABLE, strict=True))
    (tmp_path / "kick.csv").write_text(f"time,a.kick\n{rows}")
    words = ["simulate", str(file), "--accuracy", "1e-7", "-q", "-o", str(tmp_path / "run.csv")]
    drive = ["--input-file", str(tmp_path / "kick.csv"), "--input", "b.kick=2*t"]
    assert main([*words, *drive, "--trust"]) == 0, capsys.readouterr().err
    found = cosim.Trajectory.read_csv(tmp_path / "run.csv")
    inputs = {"a.kick": table("a.kick"), "b.kick": "2*t"}
    one = cosim.simulate(pair.dae, inputs=inputs, output_times=found.time)
    assert np.abs(found["a.x"] - one["a.x"]).max() < 1e-6
    assert main([*words, "--input", "x=t", "--trust"]) == 3
    assert "the system has no part 'x'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("inputs", "error", "words"),
    [
        ({"a.x": "t"}, UsageError, "a.x is no input"),
        ({"a.force": "t"}, UsageError, "a.force is connected or has a value"),
        ({"c.x": "t"}, UnknownName, "part 'c'"),
        ({"a.kick": "x + 1"}, UnknownName, r"a.kick: .* has no name .x."),
        ({"a.kick": "sin("}, ParameterError, "is no formula"),
        (5, UsageError, "inputs was given 5"),
    ],
)
def test_wrong_inputs_are_named(pair, inputs, error, words):
    with pytest.raises(error, match=words):
        pair.simulate(inputs=inputs, stop_time=1)


def test_a_value_and_a_formula_for_one_input_are_rejected(pair):
    with pytest.raises(UsageError, match="kick is connected or has a value"):
        pair.simulate(inputs={"a.kick": "t"}, start_values={"a.kick": 1.0}, stop_time=1)
