"""Small models are compiled, large ones interpreted unless compilation is requested."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from casadi import MX

import cosim
from cosim.codegen import compiler
from cosim.errors import CompilerTimeout
from cosim.integrate import preparation

NODES = 1000
OPTIONS = {"stop_time": 0.01, "output_interval": 0.005}


@pytest.fixture
def cold(tmp_path, monkeypatch):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))


def heat(nodes=NODES):
    h = 1 / (nodes + 1)
    T = MX.sym("T", nodes)
    flow = ca.diff(ca.vertcat(0, T, 0)) / h
    shape = np.sin(np.pi * h * np.arange(1, nodes + 1))
    return cosim.from_casadi({"x": T, "ode": ca.diff(flow) / h}, {"T": shape}, name="heat")


@cache
def rod():
    return heat()


def fail(*_, **__):
    pytest.fail("compiled")


@pytest.mark.slow
def test_large_model_is_interpreted_and_reports_it(cold, monkeypatch):
    monkeypatch.setattr(compiler, "compile_library", fail)
    run = cosim.simulate(heat(), **OPTIONS)
    assert not run.stats.compiled
    assert "interpreted: the model has 6002 operations" in run.stats.note
    assert run.stats.note.endswith("to compile them, give compiled=True")
    h = 1 / (NODES + 1)
    decay = np.exp(-((2 / h * np.sin(np.pi * h / 2)) ** 2) * 0.01)
    assert run["T_500"][-1] == pytest.approx(decay * run["T_500"][0], rel=1e-6)


def test_small_model_is_compiled(cold):
    run = cosim.simulate(heat(20), **OPTIONS)
    assert run.stats.compiled
    assert run.stats.note is None


def test_decision_does_not_depend_on_earlier_runs(cold, monkeypatch):
    monkeypatch.setattr(preparation, "LARGE", 10)  # compiling a large model takes its time
    dae = heat(40)
    first = cosim.simulate(dae, **OPTIONS)
    assert not first.stats.compiled
    compiled = cosim.simulate(dae, compiled=True, **OPTIONS)
    assert compiled.stats.compiled
    third = cosim.simulate(dae, **OPTIONS)
    assert not third.stats.compiled
    np.testing.assert_allclose(first.values, compiled.values, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(third.values, first.values)


def test_run_is_interpreted_where_the_compiler_gives_up_unless_compilation_is_requested(
    cold, monkeypatch
):
    def endless(*_, **__):
        raise CompilerTimeout("cc was stopped after 600 s")

    monkeypatch.setattr(compiler, "compile_library", endless)
    run = cosim.simulate(heat(21), **OPTIONS)
    assert not run.stats.compiled
    assert run.stats.note.startswith("interpreted: cc was stopped after 600 s")
    with pytest.raises(CompilerTimeout):
        cosim.simulate(heat(21), compiled=True, **OPTIONS)


@pytest.mark.slow
def test_bare_integrator_of_a_large_model_is_interpreted(cold, monkeypatch):
    monkeypatch.setattr(compiler, "compile_library", fail)
    dae = rod()
    run = cosim.integrator(dae, [0.0, 0.01], derivatives=False)
    assert np.isfinite(np.array(run(**cosim.start_vectors(dae))["xf"])).all()
