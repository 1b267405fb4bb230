"""Sweeps: the same bits in one process and on a cluster, failures as rows, no loss by kills."""

import signal
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest
from helpers import event_models
from helpers.fmu_files import remove, with_description
from helpers.foreign_part import foreign_part

import cosim
from casadi_models.dae import Model
from cosim.cli.main import main
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.integrate.ensemble.ensemble import RunState

MODEL = textwrap.dedent(
    """
    from casadi_models.dae import Model

    def growth():
        model = Model("growth", stop_time=1.0, output_interval=0.05)
        x = model.state("x", "m", 1.0, "place")
        rate = model.parameter("rate", "1/s", 0.5, "rate")
        model.derivative(x, rate * x**2)
        model.output("inverse", "1", 1 / x, "1 / x")
        return model.freeze()
    """
)
RATES = np.linspace(0.1, 0.9, 48)


@pytest.fixture
def growth(tmp_path):
    (tmp_path / "models.py").write_text(MODEL)
    return f"{tmp_path}/models.py:growth"


def same(a, b):
    assert a.states == b.states
    assert a.reasons == b.reasons
    assert list(a.numbers) == list(b.numbers)
    for name in a.numbers:
        np.testing.assert_array_equal(a[name], b[name])
    if a.data.layout.keep.trajectories:
        np.testing.assert_array_equal(a.values, b.values)
    if a.statistics:
        for kind in ("mean", "variance", "minimum", "maximum"):
            for name in a.statistics.names:
                np.testing.assert_array_equal(
                    getattr(a.statistics, kind)(name), getattr(b.statistics, kind)(name)
                )
        assert a.statistics.count == b.statistics.count


KEPT = ["trajectories", "statistics", "final", "first(x, 1.2)"]


def test_numbers_follow_the_closed_form_and_failures_are_rows(growth):
    rates = [0.5, 3.0, np.nan, 0.9]
    found = cosim.sweep(growth, {"rate": rates}, keep=KEPT, workers=0)
    assert [str(s) for s in found.states] == ["complete", "failed", "refused", "complete"]
    np.testing.assert_allclose(found["x_final"][[0, 3]], [2, 10], rtol=1e-7)
    assert np.isnan(found["x_final"][[1, 2]]).all()
    assert "step size too small at t = 0.333" in found.reasons[1]
    assert "not finite" in found.reasons[2]
    assert found.run(1).time[-1] == pytest.approx(0.3)
    np.testing.assert_allclose(found["x_first_1.2"][0], (1 - 1 / 1.2) / 0.5, rtol=2e-3)
    assert found.statistics.count == 2
    np.testing.assert_allclose(found.statistics.mean("x")[-1], 6, rtol=1e-7)
    assert found.status == "2 complete, 1 failed, 1 refused"


@pytest.fixture(scope="module")
def client():
    pytest.importorskip("distributed")
    from cosim.study.sweep.cluster import connected

    with connected("local", 2) as found:
        yield found


@pytest.mark.slow
@pytest.mark.parametrize("solver", [None, "cvodes"])
def test_bits_depend_neither_on_processes_nor_on_blocks_nor_on_order(growth, client, solver):
    def run(rates, **how):
        return cosim.sweep(growth, {"rate": rates}, keep=KEPT, solver=solver, **how)

    rates = np.append(RATES, 3.0)
    here = run(rates, workers=0)
    same(run(rates, scheduler=client), here)
    np.testing.assert_array_equal(run(rates[:5], workers=0).values, here.values[:5])
    shuffled = np.random.default_rng(5).permutation(len(rates))
    other = run(rates[shuffled], workers=0)
    np.testing.assert_array_equal(other["x_final"], here["x_final"][shuffled])


@pytest.mark.slow
def test_a_dae_and_a_scene_are_swept_like_a_model(tmp_path, growth, client):
    dae = cosim.load(growth)
    by_name = cosim.sweep(growth, {"rate": RATES[:5]}, workers=0)
    by_value = cosim.sweep(dae, {"rate": RATES[:5]}, scheduler=client)
    np.testing.assert_array_equal(by_name["x_final"], by_value["x_final"])
    scene = tmp_path / "scene.toml"
    scene.write_text(
        'title = "crank"\nmodel = "crank_shaft"\noutputs = ["phi"]\n'
        "[start]\nphi = 0.25\n[run]\nstop_time = 0.5\n"
    )
    found = cosim.sweep(scene, {"omega": [1.0, 2.0]}, workers=0)
    np.testing.assert_allclose(found["phi_final"], 0.25 + 0.5 * np.array([1, 2]) + 1.25)


@pytest.mark.slow
def test_a_function_adds_numbers_and_its_exceptions_are_rows(growth, client):
    def function(run):
        if run["x"][-1] > 5:
            raise ValueError("too much")
        return {"sum": run["x"].sum()}

    found = cosim.sweep(growth, {"rate": [0.5, 0.9]}, keep=[function], workers=0)
    again = cosim.sweep(growth, {"rate": [0.5, 0.9]}, keep=[function], scheduler=client)
    same(found, again)
    assert found["sum"][0] == pytest.approx(found_sum(0.5), rel=1e-6)
    assert found.states[1] is RunState.FAILED
    assert "ValueError: too much" in found.reasons[1]


def found_sum(rate):
    return (1 / (1 - rate * np.linspace(0, 1, 21))).sum()


def files_in(store, *names):
    return {
        path: path.stat().st_mtime_ns for name in names for path in (store / name).glob("c/*[0-9]")
    }


@pytest.mark.slow
def test_a_store_resumes_without_repeating_finished_blocks(growth, tmp_path):
    pytest.importorskip("zarr")
    xarray = pytest.importorskip("xarray")
    store = tmp_path / "store"
    whole = cosim.sweep(growth, {"rate": RATES}, keep=KEPT, workers=0)
    cosim.sweep(growth, {"rate": RATES}, keep=KEPT, workers=0, store=store)
    (store / "status/c/1").unlink()
    before = files_in(store, "status", "steps")
    assert len(before) == 5  # of 3 blocks
    before = {path: time for path, time in before.items() if path.name != "1"}
    with pytest.warns(RuntimeWarning, match="results of the runs 16 to 31 were damaged"):
        again = cosim.sweep(growth, keep=KEPT, workers=0, store=store, resume=True)
    same(again, whole)
    assert before.items() <= files_in(store, "status", "steps").items()
    with pytest.raises(UsageError, match="holds another sweep: its samples"):
        cosim.sweep(growth, {"rate": RATES + 1}, keep=KEPT, store=store, resume=True)
    with pytest.raises(UsageError, match="exists already"):
        cosim.sweep(growth, {"rate": RATES}, keep=KEPT, store=store)
    with xarray.open_zarr(store, consolidated=False, chunks=None) as data:
        np.testing.assert_array_equal(data["x"], whole.values[:, :, 0])
        np.testing.assert_array_equal(data.coords["rate"], RATES)
        np.testing.assert_array_equal(data["x_over_runs_mean"], whole.statistics.mean("x"))
        assert data["x"].attrs["units"] == "m"
    rows = again.csv_text().splitlines()
    assert rows[0].startswith("run,rate,status,reason,steps,x_final")
    assert len(rows) == len(RATES) + 1


@pytest.mark.slow
def test_a_sweep_in_memory_is_the_same_dataset_as_its_store(growth, tmp_path):
    pytest.importorskip("zarr")
    pytest.importorskip("xarray")
    rates = {"rate": [0.5, 3.0, 0.9]}
    here = cosim.sweep(growth, rates, keep=KEPT, workers=0).to_xarray()
    there = cosim.sweep(growth, rates, keep=KEPT, workers=0, store=tmp_path / "s").to_xarray()
    assert {*here.variables} == {*there.variables}
    for name in here.variables:
        np.testing.assert_array_equal(here[name].astype(there[name].dtype), there[name])
        assert here[name].dims == there[name].dims
        assert here[name].attrs == there[name].attrs
    assert {*here.coords} == {*there.coords} == {"rate", "time"}
    here.drop_vars("reason").to_netcdf(tmp_path / "sweep.nc")


KILLER = """
import os, signal
from pathlib import Path

def function(run):
    marks = Path({marks!r})
    number = round(run["inverse"][-1] * 1e6)
    if number in {once}:
        mark = marks / f"once-{{number}}"
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if number in {always}:
        with (marks / "deaths").open("a") as stream:
            stream.write("x")
        os.abort()
    return {{"number": number}}
"""


def killer(tmp_path, once, always):
    pytest.importorskip("cloudpickle")
    space = {}
    numbers = [[round((1 - rate) * 1e6) for rate in rates] for rates in (once, always)]
    exec(KILLER.format(marks=str(tmp_path), once=numbers[0], always=numbers[1]), space)
    return space["function"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_killed_workers_lose_nothing_and_a_deadly_run_is_a_row(growth, tmp_path, client):
    harmless, deadly = killer(tmp_path, [], []), killer(tmp_path, RATES[[3, 20, 41]], [RATES[30]])
    whole = cosim.sweep(growth, {"rate": RATES}, keep=[*KEPT, harmless], workers=0)
    found = cosim.sweep(growth, {"rate": RATES}, keep=[*KEPT, deadly], scheduler=client)
    assert found.states[30] is RunState.LOST
    assert "every process that computes it ends" in found.reasons[30]
    assert 2 <= len((tmp_path / "deaths").read_text()) <= 4  # twice alone, up to twice in a block
    assert len(list(tmp_path.glob("once-*"))) == 3
    others = np.arange(len(RATES)) != 30
    assert found.complete[others].all()
    np.testing.assert_array_equal(found.values[others], whole.values[others])
    np.testing.assert_array_equal(found["number"][others], whole["number"][others])


SCRIPT = """
import sys, time
import numpy as np
import cosim

def slowly(run):
    time.sleep(0.02)
    return {"end": run["x"][-1]}

if __name__ == "__main__":
    resume = sys.argv[3] == "resume"
    cosim.sweep(
        sys.argv[1], {"rate": np.linspace(0.1, 0.9, 64)}, solver="cvodes",
        keep=["trajectories", "statistics", slowly], workers=1, store=sys.argv[2], resume=resume,
    )
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGINT], ids=["killed", "Ctrl-C"])
def test_a_stopped_sweep_continues_with_the_missing_blocks(growth, tmp_path, blow):
    pytest.importorskip("zarr")
    pytest.importorskip("distributed")
    psutil = pytest.importorskip("psutil")
    script, store = tmp_path / "script.py", tmp_path / "store"
    script.write_text(SCRIPT)

    def start(how):
        call = [sys.executable, str(script), growth, str(store), how]
        return subprocess.Popen(call, start_new_session=True, stderr=subprocess.PIPE)

    process = start("begin")
    deadline = time.monotonic() + 120
    while len(files_in(store, "blocks/digest")) < 3:
        assert time.monotonic() < deadline
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.02)
    children = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(blow)
    assert children
    assert not psutil.wait_procs(children, timeout=60)[1]
    printed = process.communicate(timeout=60)[1].decode()
    if blow == signal.SIGINT:
        assert "continue with resume=True (--resume)" in printed
    stored = files_in(store, "blocks/digest")
    assert 3 <= len(stored) < 64
    process = start("resume")
    printed = process.communicate(timeout=120)[1]
    assert process.returncode == 0, printed
    assert stored.items() <= files_in(store, "blocks/digest").items()
    undisturbed = tmp_path / "undisturbed"
    cosim.sweep(
        growth, {"rate": np.linspace(0.1, 0.9, 64)}, solver="cvodes", workers=0, store=undisturbed,
        keep=["trajectories", "statistics", lambda run: {"end": run["x"][-1]}],
    )  # fmt: skip
    for path in sorted(undisturbed.rglob("*")):
        place = path.relative_to(undisturbed)
        if path.is_file() and str(place) != "zarr.json":  # that names the function
            assert (store / place).read_bytes() == path.read_bytes(), place


def test_a_cluster_of_threads_yields_the_same_bits(growth):
    distributed = pytest.importorskip("distributed")
    here = cosim.sweep(growth, {"rate": RATES}, keep=KEPT, workers=0)
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        same(cosim.sweep(growth, {"rate": RATES}, keep=KEPT, scheduler=client), here)


def test_an_fmu_is_instantiated_once_and_reset(tmp_path, client):
    path = cosim.export_fmu(cosim.load("crank_shaft"), tmp_path / "crank.fmu")
    omegas = [1.0, 2.0, 3.0]
    found = cosim.sweep(
        path, {"omega": omegas}, outputs=["phi"], keep=["trajectories", "final"], stop_time=0.5,
        workers=0,
    )  # fmt: skip
    for i, omega in enumerate(omegas):
        single = cosim.simulate_fmu(
            path, start_values={"omega": omega}, outputs=["phi"], stop_time=0.5
        )
        np.testing.assert_array_equal(found.values[i], single.values)
    there = cosim.sweep(path, {"omega": omegas}, outputs=["phi"], keep=["trajectories", "final"],
                        stop_time=0.5, scheduler=client)  # fmt: skip
    same(there, found)
    refused = cosim.sweep(path, {"omega": [1.0, np.inf]}, outputs=["phi"], stop_time=0.1, workers=0)
    assert [str(state) for state in refused.states] == ["complete", "refused"]
    with pytest.raises(UsageError, match="has no setting solver"):
        cosim.sweep(path, {"omega": omegas}, solver="cvodes", workers=0)
    with pytest.raises(UnknownName, match="omega"):
        cosim.sweep(path, {"omegaa": omegas}, workers=0)


def test_an_fmu_of_model_exchange_takes_as_many_steps_as_it_needs(tmp_path):
    model = Model("fast", stop_time=2.0, output_interval=2.0)
    x = model.state("x", "m", 1.0, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    rate = model.parameter("rate", "rad/s", 1.0, "angular frequency")
    model.derivative(x, v)
    model.derivative(v, -(rate**2) * x)
    whole = cosim.export_fmu(model.freeze(), tmp_path / "whole.fmu")
    path = with_description(whole, tmp_path / "fast.fmu", remove(".", "CoSimulation"))
    rates = np.array([1.0, 300.0])
    found = cosim.sweep(path, {"rate": rates}, outputs=["x"], relative_tolerance=1e-9, workers=0)
    assert found.status == "2 complete"
    np.testing.assert_allclose(found.numbers["x_final"], np.cos(2 * rates), atol=1e-4)
    assert {*found.reasons} == {1}
    assert "more than 500 steps between two outputs" in found.reasons[1]


@pytest.mark.slow
def test_runs_that_end_themselves_are_complete_for_a_model_and_its_fmu(tmp_path):
    dae = event_models.stopping()
    path = cosim.export_fmu(dae, tmp_path / "stopping.fmu")
    starts = {"x": np.array([0.0, 0.5])}
    for subject in (dae, path):
        keep = ["trajectories", "final", "max", lambda run: {"end": run.time[-1]}]
        found = cosim.sweep(subject, starts, outputs=["x"], keep=keep, workers=0)
        assert found.status == "2 complete"
        for name in ("x_final", "x_max"):
            np.testing.assert_allclose(found[name], 0.777, atol=1e-9)
        np.testing.assert_allclose(found["end"], 0.777 - starts["x"], atol=1e-9)
        moving = starts["x"][:, None] + found.time
        before = moving < 0.777
        np.testing.assert_allclose(found.values[before, 0], moving[before], atol=1e-9)
        assert np.isnan(found.values[~before]).all()


@pytest.mark.slow
def test_wrong_arguments_are_rejected_before_any_run(growth):
    with pytest.raises(UnknownName, match="rate"):
        cosim.sweep(growth, {"ratee": [1.0]})
    with pytest.raises(UnknownName, match="output"):
        cosim.sweep(growth, {"rate": [1.0]}, outputs=["y"])
    with pytest.raises(UsageError, match="nothing varies"):
        cosim.sweep(growth)
    with pytest.raises(ParameterError, match="workers"):
        cosim.sweep(growth, {"rate": [1.0]}, workers=-1)
    with pytest.raises(UsageError, match="leave workers out"):
        cosim.sweep(growth, {"rate": [1.0]}, scheduler="tcp://127.0.0.1:1", workers=2)
    with pytest.raises(UsageError, match="no store to resume"):
        cosim.sweep(growth, {"rate": [1.0]}, resume=True)


def test_a_run_from_the_end_has_its_reason(growth):
    found = cosim.sweep(growth, {"rate": [0.5, 2.0]}, keep=["trajectories"], workers=0)
    assert found.run(-1).status == found.run(1).status == found.reasons[1]


@pytest.mark.slow
def test_sobol_indices_of_a_linear_number_are_its_shares():
    pytest.importorskip("SALib")
    from SALib.analyze import sobol as analyze
    from SALib.sample import sobol as sample

    problem = {"num_vars": 2, "names": ["phi", "omega"], "bounds": [[0, 1], [0, 2]]}
    samples = dict(zip(problem["names"], sample.sample(problem, 64, seed=0).T, strict=True))
    found = cosim.sweep(
        "crank_shaft", samples, outputs=["phi"], output_times=[1.0], workers=0,
        relative_tolerance=1e-9,
    )  # fmt: skip
    indices = analyze.analyze(
        problem, found["phi_final"], seed=0
    )  # phi + omega + 5: variances 1/12 and 4/12
    np.testing.assert_allclose(indices["S1"], [0.2, 0.8], atol=0.05)
    np.testing.assert_allclose(indices["ST"], [0.2, 0.8], atol=0.05)


NO_GUARD = """
import os
import numpy as np
import cosim

def function(run):
    if abs(run["phi"][-1] - 5.5) < 1e-6:
        with open("deaths", "a") as stream:
            stream.write("x")
        os._exit(9)
    return {"end": run["phi"][-1]}

found = cosim.sweep(
    "crank_shaft", {"omega": np.arange(32) / 2}, outputs=["phi"], output_times=[1.0],
    keep=[function], scheduler="local", workers=2,
)
print(found.status, [i for i, state in enumerate(found.states) if state == "lost"])
"""


@pytest.mark.slow
def test_a_script_without_guard_uses_processes_and_loses_only_its_deadly_run(tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "script.py").write_text(NO_GUARD)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.stdout == "31 complete, 1 lost [1]\n", done.stderr
    assert done.stderr == ""
    assert (tmp_path / "deaths").read_text() == "xxxx"  # twice in its block, twice alone


@pytest.mark.slow
def test_program_without_standard_streams_sweeps(growth, monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)  # as in a program with windows
    x = cosim.sweep(growth, {"rate": [0.0, 0.5]}, workers=0)["x_final"]
    np.testing.assert_allclose(x, [1.0, 2.0], rtol=1e-6)  # 1 / (1 - rate t)


def test_sweep_prints_as_a_summary():
    keep = ["max(T)", "first(phi, 1)", lambda run: {"turns": 2.0}]
    found = cosim.sweep("crank_shaft", {"omega": [40, 50]}, keep=keep, stop_time=0.1, workers=0)
    head, _, *rows = repr(found).splitlines()
    assert head == "crank_shaft/driven: 2 runs, 2 complete"
    assert rows[0].split() == ["omega", "(varied)", "rad/s", "40", "50"]
    assert rows[1].split()[:2] == ["T_max", "N.m"]
    assert rows[2].split()[:2] == ["phi_first_1", "s"]
    assert rows[3].split() == ["turns", "2", "2"]
    stored = found.to_xarray()
    assert [stored[name].units for name in ("omega", "T_max", "phi_first_1")] == [
        "rad/s",
        "N.m",
        "s",
    ]
    assert "units" not in stored["turns"].attrs


def test_runs_of_an_fmu_whose_reset_is_incomplete_do_not_depend_on_each_other(tmp_path):
    path = foreign_part(tmp_path, "plant", resets=False)
    found = cosim.sweep(path, {"u": [2.0, 2.0, 2.0]}, outputs=["y"], stop_time=1.0, workers=0)
    assert found["y_final"] == pytest.approx(4.0, rel=1e-12)  # (u + 10)/3; 4, 8 and 12 before


@pytest.mark.slow
def test_command_without_workers_survives_an_fmu_that_aborts(tmp_path, capsys):
    path = foreign_part(tmp_path, "plant", fault="if (self->u == 2) abort()")
    line = ["sweep", str(path), "--trust", "-p", "u=-1,2,5", "--outputs", "y", "--workers", "0"]
    assert main(line) == 0
    printed = capsys.readouterr()
    rows = [line.split(",") for line in printed.out.splitlines()[1:]]
    assert [row[2] for row in rows] == ["complete", "failed", "complete"]
    assert "the FMU crashed (SIGABRT) while it ran" in rows[1][3]
    assert [float(row[-1]) for row in rows[::2]] == pytest.approx([3.0, 5.0], rel=1e-12)


def test_summary_has_the_first_reason_and_names_can_be_asked_for():
    def fails(run):
        raise ValueError("no such number")

    found = cosim.sweep(
        "crank_shaft", {"omega": [40.0]}, keep=[fails, "final"], workers=0, stop_time=0.1
    )
    assert "crank_shaft/driven: 1 run, 1 failed" in repr(found)
    assert "1 with a reason, the first one: run 0: " in repr(found)
    assert "no such number" in repr(found)
    assert "omega" in found
    assert "phi" not in found
    assert [*found] == ["omega", *found.numbers]
