"""Large models: the same derivatives by a loop, the same bits in pieces."""

from functools import partial
from inspect import unwrap

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import casadi_models
import cosim
from cosim.codegen import functions as directional_jacobian
from cosim.codegen.fmu import derivatives
from cosim.codegen.functions import (
    driven_equations,
    equations,
    has_long_jacobian,
    hoisted_laws,
    is_large,
)
from cosim.integrate.preparation import LARGE

MODELS = ("bicycle/independent", "bicycle/multipliers", "double_pendulum/multipliers")


def at_random(function: ca.Function, seed: int = 3) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.uniform(0.2, 1.0, function.size_in(i)) for i in range(function.n_in())]


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("derivative", ["jacobian_function", "directional_function"])
def test_derivatives_of_an_fmu_are_the_same_on_both_sides_of_the_limit(
    name, derivative, monkeypatch
):
    dae, function = cosim.load(name), unwrap(getattr(derivatives, derivative))  # not cached
    formulas = function(dae)
    monkeypatch.setattr(derivatives, "is_large", lambda _: True)
    loop = function(dae)
    assert formulas.n_nodes() != loop.n_nodes()
    arguments = at_random(formulas)
    for expected, found in zip(formulas(*arguments), loop(*arguments), strict=True):
        size = max(1.0, float(ca.norm_inf(ca.vec(expected)))) if expected.numel() else 1.0
        # 6 x 6 to 30 x 30 linear equations stand between both
        np.testing.assert_allclose(found.full(), expected.full(), rtol=1e-9, atol=1e-11 * size)


@pytest.mark.slow
def test_banded_jacobian_takes_as_many_directions_as_its_band_is_wide():
    x = SX.sym("x", 2000)
    banded = ca.vertcat(x[1:], 0) * x - ca.vertcat(0, x[:-1])
    dense = x * ca.sum1(x)
    assert not has_long_jacobian([x], banded, x)
    assert has_long_jacobian([x], dense, x)


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_no_formulation_of_the_catalogue_is_large(name):
    dae = cosim.load(name)
    assert not is_large(dae)
    symbols = [dae.t, dae.x, dae.z, dae.u, dae.p]
    assert ca.Function("laws", symbols, [dae.ode, dae.alg]).n_instructions() <= LARGE


@pytest.mark.parametrize(
    "function",
    [lambda dae: driven_equations(hoisted_laws(dae)), partial(equations, sensitivities=False)],
)
def test_jacobian_in_a_loop_is_as_sparse_as_the_equations(function, monkeypatch):
    """Solvers take its pattern from the function: 2500 nodes of a grid are 12,300 entries."""
    monkeypatch.setattr(directional_jacobian, "MOST_OPERATIONS", 100)
    x, z = ca.MX.sym("x", 60), ca.MX.sym("z", 60)
    laws = {"ode": ca.diff(ca.vertcat(0, z)), "alg": z - ca.diff(ca.vertcat(x, 0))}
    dae = cosim.from_casadi({"x": x, "z": z, **laws}, name="band")
    found = function(dae)
    assert "loop" in str([f.name() for f in found.jacobian().find_functions()])
    for i, law in enumerate((dae.ode, dae.alg)):
        for j, unknown in ((1, dae.x), (2, dae.z)):
            assert found.jac_sparsity(i, j) == ca.jacobian_sparsity(law, unknown)
