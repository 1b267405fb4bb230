"""Large models are interpreted first, and compiled when that pays; small ones are compiled."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from casadi import MX

import cosim
from cosim.codegen import compiler
from cosim.errors import CompilerExhausted
from cosim.integrate.families.sundials import Cvodes
from cosim.integrate.run import worthwhile as deciding
from cosim.integrate.run.worthwhile import worthwhile

NODES = 1000
OPTIONS = {"stop_time": 0.01, "output_interval": 0.005}


@pytest.fixture
def cold(tmp_path, monkeypatch):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))


def heat(nodes=NODES, **options):
    h = 1 / (nodes + 1)
    T = MX.sym("T", nodes)
    flow = ca.diff(ca.vertcat(0, T, 0)) / h
    shape = np.sin(np.pi * h * np.arange(1, nodes + 1))
    return cosim.from_casadi({"x": T, "ode": ca.diff(flow) / h}, {"T": shape}, name="heat")


@cache
def rod():
    return heat()


def refuse(*_, **__):
    pytest.fail("compiled")


def test_large_model_is_interpreted_at_first_and_says_so(cold, monkeypatch):
    monkeypatch.setattr(compiler, "compile_library", refuse)
    run = cosim.simulate(heat(), **OPTIONS)
    assert not run.stats.compiled
    assert "interpreted: 6002 operations take about" in run.stats.note
    assert run.stats.note.endswith("compiled=True compiles them")
    h = 1 / (NODES + 1)
    decay = np.exp(-((2 / h * np.sin(np.pi * h / 2)) ** 2) * 0.01)
    assert run["T_500"][-1] == pytest.approx(decay * run["T_500"][0], rel=1e-6)


def test_small_model_is_compiled_as_ever(cold):
    run = cosim.simulate(heat(20), **OPTIONS)
    assert run.stats.compiled
    assert run.stats.note is None


def test_runs_that_have_paid_for_the_compiler_are_compiled(monkeypatch):
    dae = heat(900)
    choice = worthwhile(dae, Cvodes(), 11, not_kept)
    assert not choice.compiled
    choice.add(1000.0)
    assert worthwhile(dae, Cvodes(), 11, not_kept).compiled


def test_one_run_that_is_long_enough_is_compiled():
    assert worthwhile(rod(), Cvodes(), 1_000_000, not_kept).compiled


def test_what_the_cache_holds_is_taken_whatever_it_saves():
    assert worthwhile(rod(), Cvodes(), 11, lambda: None).compiled


def not_kept():
    raise compiler.NotKept


def test_interpreted_and_compiled_runs_of_a_large_model_agree(cold, monkeypatch):
    # One that is large by decree: compiling one that is takes its time
    monkeypatch.setattr(deciding, "SMALL", 10)
    dae = heat(40)
    first = cosim.simulate(dae, **OPTIONS)
    assert not first.stats.compiled
    compiled = cosim.simulate(dae, compiled=True, **OPTIONS)
    third = cosim.simulate(dae, **OPTIONS)
    assert third.stats.compiled  # as the cache has it now
    np.testing.assert_allclose(first.values, compiled.values, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(third.values, compiled.values)


def test_compiler_without_memory_leaves_the_run_interpreted_unless_it_was_asked_for(
    cold, monkeypatch
):
    def exhausted(*_, **__):
        raise CompilerExhausted("cc needs more than 4 GB of memory")

    monkeypatch.setattr(compiler, "compile_with_less", exhausted)
    run = cosim.simulate(heat(21), **OPTIONS)
    assert not run.stats.compiled
    assert run.stats.note.startswith("interpreted: cc needs more than 4 GB of memory")
    with pytest.raises(CompilerExhausted):
        cosim.simulate(heat(21), compiled=True, **OPTIONS)


def test_bare_integrator_of_a_large_model_is_not_compiled_for_one_run(cold):
    dae = rod()
    with compiler.only_kept():
        run = cosim.integrator(dae, [0.0, 0.01], derivatives=False)
        with pytest.raises(compiler.NotKept):
            cosim.integrator(dae, [0.0, 0.01], derivatives=False, compiled=True)
    assert np.isfinite(np.array(run(**cosim.start_vectors(dae))["xf"])).all()


def test_many_runs_pay_for_the_compiler_where_one_does_not():
    dae = heat(850)
    assert not worthwhile(dae, Cvodes(), 11, not_kept).compiled
    assert worthwhile(dae, Cvodes(), 11, not_kept, runs=1000).compiled
