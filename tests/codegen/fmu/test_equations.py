"""The solver's step of co-simulation, with its equations written out or called."""

import math
import re

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from cosim.codegen import functions as directional_jacobian
from cosim.codegen.fmu import equations
from cosim.codegen.fmu.derivatives import (
    adjoint_function,
    directional_function,
    jacobian_function,
)
from cosim.codegen.fmu.equations import fmu_laws, generated_code, model_functions, solver_step


@pytest.mark.parametrize("loop", [False, True])
def test_step_that_calls_the_equations_is_the_one_that_writes_them_out(loop, monkeypatch):
    """Time, inputs, parameters and algebraic unknowns in it; with formulas and with a loop."""
    monkeypatch.setattr(directional_jacobian, "MOST_OPERATIONS", 0 if loop else 1e9)
    x, z, u, p, t = (ca.SX.sym(name) for name in "xzupt")
    system = {"t": t, "x": x, "z": z, "u": u, "p": p, "ode": u * ca.sin(3 * t) - p * x * z}
    system["alg"] = z**3 + z - x - u
    dae = cosim.from_casadi(system, {"x": 1.0, "p": 2.0}, nominals={"x": 8.0})
    laws = fmu_laws(dae, None, derivatives=True, adjoint=False)
    c = np.array(laws.constants(2.0)).ravel()
    arguments = [1.0, 0.7, [0.2, 0.5, 1e-9, 1.0, 0.3, -0.2, 0.1, *c]]
    found = []
    for large in (False, True):
        monkeypatch.setattr(equations, "is_large", lambda dae, large=large: large)
        found.append(np.hstack([np.array(r) for r in solver_step(laws, "rosenbrock")(*arguments)]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-12)


def test_rosenbrock_of_a_large_model_has_no_formulas_of_a_jacobian():
    n = 60
    x = ca.SX.sym("x", n)
    weights = ca.DM(np.random.default_rng(0).normal(size=(n, n)))
    dae = cosim.from_casadi({"x": x, "ode": -ca.sin(weights @ ca.sin(x)) * x}, {"x": 0.1})
    laws = fmu_laws(dae, None, derivatives=True, adjoint=False)
    functions = model_functions(laws, None, SX(0, 1), derivatives=True, adjoint=False)
    code = generated_code(laws, "m", functions, "rosenbrock", has_events=False)
    jacobian, laws = (
        re.search(rf"/\* {name}:.*?\n}}\n", code, re.DOTALL)[0] for name in ("jacF", "model_ode")
    )
    assert len(jacobian) < len(laws)  # formulas are twice as long


@pytest.mark.parametrize("name", ["cart_", "cart__pole"])
def test_underscores_that_casadi_takes_for_its_own_may_be_in_a_models_name(name, tmp_path):
    """Its code generator refuses two in a row, at the end of a name, too."""
    x = ca.SX.sym("x")
    dae = cosim.from_casadi({"x": x, "ode": -x}, {"x": 1.0}, name=name)
    run = cosim.simulate_fmu(cosim.export_fmu(dae, tmp_path / "m.fmu"), stop_time=1.0)
    assert run["x"][-1] == pytest.approx(math.exp(-1), abs=1e-8)


def test_law_that_prints_is_exported(tmp_path):
    """CasADi's code includes stdio.h, which must not be hidden with the model's functions."""
    x = ca.SX.sym("x")
    law = ca.if_else(x < 0, x.printme(x), -x)  # silent here, and compiled
    dae = cosim.from_casadi({"x": x, "ode": law}, {"x": 1.0}, name="printing")
    run = cosim.simulate_fmu(cosim.export_fmu(dae, tmp_path / "m.fmu"), stop_time=1.0)
    assert run["x"][-1] == pytest.approx(math.exp(-1), abs=1e-8)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("name", ["bicycle", "bicycle/multipliers", "double_pendulum/multipliers"])
@pytest.mark.parametrize("derivative", [directional_function, jacobian_function, adjoint_function])
def test_derivatives_take_the_constants_of_the_instance_and_keep_their_bits(name, derivative):
    dae = cosim.load(name)
    laws = fmu_laws(dae, None, derivatives=True, adjoint=True)
    alone, shared = derivative(dae), derivative(dae, laws)
    rng = np.random.default_rng(4)
    arguments = [rng.uniform(0.2, 1.0, alone.size_in(i)) for i in range(alone.n_in())]
    parameters = arguments[4]
    expected = alone(*arguments)
    arguments[4] = laws.constants(parameters)
    for one, other in zip(expected, shared(*arguments), strict=True):
        np.testing.assert_array_equal(other.full(), one.full())
    lengths = [
        sum(part.n_instructions() for part in function.find_functions(0) if part.is_a("SXFunction"))
        for function in (alone, shared)
    ]
    assert lengths[1] < lengths[0]


def test_laws_that_are_kept_longer_than_their_derivatives_still_have_them():
    """As of the sixth model of a process, if the first one is exported again."""
    first, *others = models = [cosim.Model(f"model_{k}") for k in range(6)]
    for model in models:
        x, k = model.state("x", "1", 1.0, "x"), model.parameter("k", "1/s", 1.0, "rate")
        model.derivative(x, -k * x)
    laws = fmu_laws(first.freeze(), None, derivatives=True, adjoint=True)
    for model in others:
        fmu_laws(model.freeze(), None, derivatives=True, adjoint=True)
    assert model_functions(laws, None, SX(0, 1), derivatives=True, adjoint=True)
