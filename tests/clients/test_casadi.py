"""CasADi as importer: an FMU as functions, with derivatives, against the model it was made from."""

import casadi as ca
import numpy as np
import pytest
from helpers.fmi_cases import VERSIONS
from helpers.samples import sampled

import casadi_models
import cosim
from casadi_models.dae import Dae
from cosim.codegen.initialization import algebraic_function, start_function

EVERY = pytest.mark.parametrize("name", sampled(casadi_models.CATALOG))


def numbers(variables) -> list[float]:
    return [float(variable.start or 0.0) for variable in variables]


def native(dae: Dae) -> ca.Function:
    """Return dx/dt (t, x, u, p) of a model, its algebraic unknowns solved for."""
    t, x, u, p = (
        ca.MX.sym(n, s.numel()) for n, s in zip("txup", (dae.t, dae.x, dae.u, dae.p), strict=True)
    )
    z = algebraic_function(dae)(t, x, numbers(dae.algebraics), u, p)
    ode = ca.Function("ode", [dae.t, dae.x, dae.z, dae.u, dae.p], [dae.ode])
    return ca.Function("native", [t, x, u, p], [ode(t, x, z, u, p)])


def point(dae: Dae) -> tuple[np.ndarray, np.ndarray]:
    """Return a state near the start, and the model's own start."""
    known = list(dae.x_start), numbers(dae.inputs), numbers(dae.parameters)
    start = start_function(dae)(0.0, *known)[0].full().ravel()
    nominal = np.array([state.nominal for state in dae.states])
    return start + 0.05 * nominal * np.random.default_rng(3).standard_normal(len(start)), start


@pytest.mark.slow_rows(
    "crank_shaft/multipliers-2",
    "crank_shaft/multipliers-3",
    "bar_on_frame/reduced-2",
    "bar_on_frame/reduced-3",
    "bicycle/multipliers-2",
    "bicycle/multipliers-3",
    "disk_two_bars/reduced-3",
    "double_pendulum/quaternion-2",
    "double_pendulum/quaternion-3",
)
@VERSIONS
@EVERY
def test_variables_start_values_equations_and_derivatives_are_the_models(name, fmi, exported):
    dae = cosim.load(name)
    fmu = ca.DaeBuilder(name.replace("/", "_"), str(exported(name, fmi)))
    assert fmu.x() == [state.name for state in dae.states]
    assert fmu.u() == [variable.name for variable in dae.inputs]
    assert set(fmu.y()) >= {output.name for output in dae.output_variables}
    assert set(fmu.p()) | set(fmu.c()) == {parameter.name for parameter in dae.parameters}

    x, start = point(dae)
    nominal = np.array([state.nominal for state in dae.states])
    assert np.abs((np.array(fmu.start(fmu.x())) - start) / nominal).max(initial=0) < 1e-12
    u, p = numbers(dae.inputs), numbers(dae.parameters)
    chosen = [i for i, parameter in enumerate(dae.parameters) if parameter.name in fmu.p()]
    assert list(fmu.start(fmu.p())) == [p[i] for i in chosen]

    f = fmu.create("f", ["t", "x", "u", "p"], ["ode", "jac_ode_x", "jac_ode_p"])
    got = [result.full() for result in f(0.3, x, u, [p[i] for i in chosen])]
    model = native(dae)
    wanted = [model(0.3, x, u, p), *(model.jacobian()(0.3, x, u, p, 0)[i] for i in (1, 3))]
    wanted = [ca.DM(result).full() for result in wanted]
    wanted[2] = wanted[2][:, chosen]
    for mine, theirs in zip(got, wanted, strict=True):
        size = np.maximum(np.abs(theirs).max(initial=0), 1.0)
        assert np.abs(mine - theirs).max(initial=0) < 1e-12 * size  # measured 1e-15


@pytest.mark.slow
@VERSIONS
def test_cvodes_through_the_fmu_is_the_native_run(fmi, exported):
    dae = cosim.load("bicycle/independent")
    fmu = ca.DaeBuilder("bicycle", str(exported("bicycle/independent", fmi)))
    u, x0 = numbers(dae.inputs), np.array(fmu.start(fmu.x()))
    p = fmu.start(fmu.p())
    f = fmu.create("f", ["t", "x", "u", "p"], ["ode"])
    t, x = ca.MX.sym("t"), ca.MX.sym("x", len(x0))
    problem = {"t": t, "x": x, "ode": f(t, x, u, p)}
    options = {"reltol": 1e-10, "abstol": 1e-12}
    end = ca.integrator("run", "cvodes", problem, 0, 1.0, options)(x0=x0)["xf"].full().ravel()
    run = cosim.simulate(dae, stop_time=1.0, solver="dop853", relative_tolerance=1e-12)
    nominal = np.array([state.nominal for state in dae.states])
    wanted = np.array([run[state.name][-1] for state in dae.states])
    assert np.abs((end - wanted) / nominal).max() < 1e-7  # 1000 tolerances


@pytest.mark.slow
def test_forward_sensitivities_to_all_parameters_are_those_of_differences(tmp_path):
    """Every parameter that matters in a run, asked to be tunable: geometry and inertias, too."""
    dae = cosim.load("bicycle/independent")
    path = cosim.export_fmu(dae, tmp_path / "bicycle.fmu", tunable=["all"])
    fmu = ca.DaeBuilder("bicycle", str(path))
    u, x0, p0 = numbers(dae.inputs), np.array(fmu.start(fmu.x())), np.array(fmu.start(fmu.p()))
    x0[0] += 0.05  # a roll: something to depend on the parameters
    assert len(p0) > 20
    f = fmu.create("f", ["t", "x", "u", "p"], ["ode"])
    t, x, p = ca.MX.sym("t"), ca.MX.sym("x", len(x0)), ca.MX.sym("p", len(p0))
    problem = {"t": t, "x": x, "p": p, "ode": f(t, x, u, p)}
    options = {"reltol": 1e-11, "abstol": 1e-13}
    run = ca.integrator("run", "cvodes", problem, 0, 0.3, options)
    sensitivities = run.factory("forward", ["x0", "p", "fwd:p"], ["fwd:xf"])
    got = sensitivities(x0, p0, np.eye(len(p0))).full()

    step = 1e-5 * np.maximum(np.abs(p0), 0.1)
    model, every = native(dae), {q.name: i for i, q in enumerate(dae.parameters)}
    place = [every[name] for name in fmu.p()]
    q = ca.MX.sym("q", len(every))
    plain = {"t": t, "x": x, "p": q, "ode": model(t, x, u, q)}
    again = ca.integrator("again", "cvodes", plain, 0, 0.3, options)
    base = np.array(numbers(dae.parameters))

    def end(i: int, sign: int) -> np.ndarray:
        moved = base.copy()
        moved[place[i]] += sign * step[i]
        return again(x0=x0, p=moved)["xf"].full().ravel()

    wanted = np.array([(end(i, 1) - end(i, -1)) / (2 * step[i]) for i in range(len(p0))]).T
    assert np.abs(got - wanted).max() < 1e-6 * max(1.0, np.abs(wanted).max())
