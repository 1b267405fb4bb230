"""`tradeoff` of a coupled system: methods and macro steps."""

import csv
import io
import json
from functools import partial

import numpy as np
import pytest

import cosim
from cosim.cli.main import main
from cosim.coupling.files import read_system
from cosim.errors import UsageError
from cosim.present.study_figures import draw_methods
from cosim.study.tradeoff.configuration import Selection

FOLDER = "examples/coupled"


@pytest.fixture(scope="module")
def table():
    system = read_system(f"{FOLDER}/dual_mass.toml")
    return cosim.tradeoff(system, selection=Selection(steps=(0.05, 0.025, 0.0125)), repeats=0)


def test_orders_of_the_methods_are_those_of_theory(table):
    expected = {"jacobi": 1, "gauss_seidel": 1, "extrapolated": 4, "iterated": 4}
    last = {row["method"]: row for row in table if row["step"] == 0.0125}
    assert last.keys() == expected.keys()
    for method, row in last.items():
        if row["order"] is not None:  # of held inputs, the error is too large for an order
            assert row["order"] == pytest.approx(expected[method], abs=0.2)
    assert last["iterated"]["order"] is not None


def test_errors_are_those_against_the_one_model(table):
    (row,) = (r for r in table if r["method"] == "iterated" and r["step"] == 0.025)
    system = read_system(f"{FOLDER}/dual_mass.toml")
    run = system.simulate(macro_step=0.025, output_interval=0.025)
    exact = cosim.simulate(
        system.dae, solver="dop853", relative_tolerance=1e-12, output_interval=0.025
    )
    sizes = {column.name: column.nominal for column in exact.columns}
    shared = [name for name in run.names if name in sizes]
    apart = max(np.abs(run[name] - exact[name]).max() / sizes[name] for name in shared)
    assert row["error"] == pytest.approx(apart, rel=1e-6)
    assert row["macro_steps"] == run.stats["macro_steps"]
    assert row["part_steps"] == max(run.stats["part_steps"].values())


def test_pareto_front_is_not_beaten(table):
    front = [row for row in table if row["pareto"]]
    assert front
    for on in front:
        assert not any(r["ms"] < on["ms"] and r["error"] < on["error"] for r in table)


@pytest.mark.slow
def test_command_line_writes_table_and_figure(tmp_path, capsys):
    words = ["tradeoff", f"{FOLDER}/cut_pendulum.toml", "--steps", "20ms,2.5ms", "--repeats", "0"]
    target, figure = tmp_path / "t.csv", tmp_path / "t.png"
    assert main([*words, "-o", str(target), "--figure", str(figure)]) == 0
    rows = list(csv.DictReader(io.StringIO(target.read_text())))
    assert len(rows) == 8
    by = {(row["method"], float(row["step"])): row for row in rows}
    assert float(by["jacobi", 0.0025]["error"] or np.inf) > 10  # a stiff hinge diverges
    assert "0.02 s is too long for jacobi" in by["jacobi", 0.02]["status"]
    assert not by["jacobi", 0.02]["error"]
    assert float(by["iterated", 0.0025]["error"]) < 1e-3
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "iterated" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)) == 8


def test_figure_names_methods_and_orders(table):
    figure = draw_methods(table)
    (axis,) = figure.axes
    assert {text.get_text() for text in axis.texts} == {f"order {k}" for k in (1, 2, 3, 4)}
    labels = [line.get_label() for line in axis.lines]
    assert {"jacobi", "gauss-seidel", "extrapolated", "iterated", "diverged"} <= set(labels)


def test_solvers_are_measured_with_the_one_model(capsys):
    words = ["tradeoff", f"{FOLDER}/loop.toml", "--solvers", "dop853", "--tolerances", "1e-6"]
    assert main([*words, "--backends", "native", "--repeats", "0"]) == 0
    assert "dop853" in capsys.readouterr().out
    system = read_system(f"{FOLDER}/loop.toml")
    assert main(["tradeoff", f"{FOLDER}/loop.toml", "--repeats", "-1"]) == 2
    with pytest.raises(UsageError, match="stop_time is for coupled systems"):
        cosim.tradeoff("crank_shaft", stop_time=1.0)
    for others in ({"selection": Selection(solvers=("erk",))}, {"solver": "erk"}):
        with pytest.raises(UsageError, match=r"give steps, start_time, .* and no others"):
            cosim.tradeoff(system, **others)


def test_parts_that_are_files_have_a_tight_co_simulation_as_reference(tmp_path):
    model = read_system(f"{FOLDER}/dual_mass.toml")
    system = cosim.read_ssp(model.write_ssp(tmp_path / "dual_mass.ssp"))
    chosen = Selection(steps=(0.05, 0.025))
    found, own = (
        [r for r in cosim.tradeoff(s, selection=chosen, repeats=0) if r["method"] == "iterated"]
        for s in (system, model)
    )
    for a, b in zip(found, own, strict=True):
        assert a["error"] == pytest.approx(b["error"], rel=0.1)


def test_what_the_time_limit_leaves_out_is_listed():
    system = read_system(f"{FOLDER}/loop.toml")
    table = cosim.tradeoff(system, seconds=0.0)
    assert {row["status"] for row in table} == {"left out: the time limit was reached"}
    draw_methods(table)


def test_files_of_others_do_not_run_in_this_process(tmp_path, monkeypatch, capsys):
    path = read_system(f"{FOLDER}/loop.toml").write_ssp(tmp_path / "loop.ssp")
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))  # which knows no file
    assert main(["tradeoff", str(path), "--repeats", "0"]) == 2
    assert "was not exported here; use simulate --method" in capsys.readouterr().err


def test_times_values_and_outputs_of_a_command_line_count(capsys):
    words = ["tradeoff", f"{FOLDER}/dual_mass.toml", "--steps", "50ms", "--repeats", "0", "--json"]
    assert main(words) == 0
    usual = json.loads(capsys.readouterr().out)
    changes = ["--stop-time", "0.5", "-p", "a.x=2", "--outputs", "b.x"]
    assert main([*words, *changes]) == 0
    changed = json.loads(capsys.readouterr().out)
    assert {row["macro_steps"] for row in changed} == {10} != {row["macro_steps"] for row in usual}
    assert {row["worst"] for row in changed} == {"b.x"}
    run, exact = (
        simulate(
            start_values={"a.x": 2}, stop_time=0.5, output_interval=0.05, outputs=["b.x"], **ways
        )
        for simulate, ways in (
            (read_system(words[1]).simulate, {"macro_step": 0.05, "method": "jacobi"}),
            (partial(cosim.simulate, read_system(words[1]).dae), {"relative_tolerance": 1e-11}),
        )
    )
    error = np.abs(run["b.x"] - exact["b.x"]).max()
    assert changed[0]["error"] == pytest.approx(error, rel=1e-4)
    assert main([*words, "-p", "a.nonsense=3"]) == 3


@pytest.mark.slow
def test_run_that_a_stop_ends_too_early_is_not_complete():
    stopper = cosim.Model("stopper", stop_time=2.0, output_interval=0.01)
    u = stopper.input("u", "m", 0.0, "place of the mass")
    x = stopper.state("x", "m", 0.0, "distance")
    stopper.derivative(x, 1.0)
    stopper.stop(u < -0.999, "far out")  # the motion turns before, a wrong one does not
    mass = cosim.Model("mass", stop_time=2.0, output_interval=0.01)
    pull = mass.input("pull", "N", 0.0, "spring")
    y, v = mass.state("y", "m", 0.99, "place"), mass.state("v", "m/s", 0.0, "speed")
    mass.derivative(y, v)
    mass.derivative(v, pull)
    mass.output("place", "m", y, "place")
    spring = cosim.Model("spring", stop_time=2.0, output_interval=0.01)
    place = spring.input("place", "m", 0.0, "place")
    idle = spring.state("idle", "1", 0.0, "nothing")
    spring.derivative(idle, -idle)
    spring.output("pull", "N", -10 * place, "pull")
    parts = {"mass": mass.freeze(), "spring": spring.freeze(), "stopper": stopper.freeze()}
    wires = {"mass.pull": "spring.pull", "spring.place": "mass.place", "stopper.u": "mass.place"}
    table = cosim.tradeoff(cosim.couple(parts, wires), selection=Selection(steps=(0.1,)), repeats=0)
    rows = {row["method"]: row for row in table}
    assert rows["jacobi"]["status"].startswith("it ends at 0.8 s, the reference at 2 s")
    assert rows["jacobi"]["error"] is None
    assert not rows["jacobi"]["pareto"]
    assert rows["iterated"]["status"] == "complete"
