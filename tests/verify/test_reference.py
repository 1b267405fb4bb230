"""The reference: closed forms stay within its own error estimate; the cache gives it back."""

import numpy as np
import pytest
from helpers.oscillators import blow_up

import cosim
from casadi_models.dae import Dae, Model
from cosim.errors import SolverError
from cosim.model import catalogue
from cosim.verify import reference as references
from cosim.verify.reference import reference, reference_key


def oscillator(damping: float = 0.2) -> Dae:
    """Return x'' + damping x' + x = 0."""
    model = Model("oscillator", stop_time=10.0, output_interval=0.1)
    x = model.state("x", "m", 1.0, "displacement")
    v = model.state("v", "m/s", 0.0, "velocity")
    b = model.parameter("b", "1", damping, "damping")
    model.derivative(x, v)
    model.derivative(v, -x - b * v)
    return model.freeze()


@pytest.fixture
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path))
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.0, 0.2, 1.9])
def test_closed_form_of_an_oscillator_lies_within_the_estimated_error(damping):
    found = reference(oscillator(damping))
    t, decay = found.run.time, damping / 2
    rate = np.sqrt(1 - decay**2)
    exact = np.exp(-decay * t) * (np.cos(rate * t) + decay / rate * np.sin(rate * t))
    error = np.abs(found.run["x"] - exact).max()
    assert error < 3 * found.errors["x"]  # measured 0.5 to 1.1
    assert found.error() < 1e-12  # measured 4e-15 to 2e-13


def test_closed_form_of_the_crank_lies_within_the_estimated_error():
    found = reference(catalogue.load("crank_shaft/driven"))
    t = found.run.time
    error = np.abs(found.run["phi"] - (50 * t + 5 * t**2)).max() / 100.0
    assert error < 3 * found.errors["phi"]  # measured 1.0


@pytest.mark.slow
def test_two_different_methods_make_a_reference():
    found = reference(oscillator())
    assert found.method.split()[0] != found.check.split()[0]


@pytest.mark.slow
def test_error_of_one_method_shows_in_the_estimate(own_cache, monkeypatch):
    """With two methods only, one of them off by 1e-6 of the nominal value."""
    original = references.execute

    def spoiled(request):
        run = original(request)
        if request.solver.name == "erk":
            values = run.values.copy()
            values[50, 0] += 1e-6
            return references.replace(run, values=values)
        return run

    monkeypatch.setattr(references, "METHODS", references.METHODS[:2])
    monkeypatch.setattr(references, "execute", spoiled)
    assert reference(oscillator()).error() == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.slow
def test_methods_that_agree_outvote_one_that_does_not(own_cache, monkeypatch):
    original = references.execute

    def spoiled(request):
        run = original(request)
        wrong = request.solver.name == "erk"
        return references.replace(run, values=run.values * (1 + 1e-3 * wrong))

    monkeypatch.setattr(references, "execute", spoiled)
    found = reference(oscillator())
    assert "erk" not in found.method + found.check
    assert found.error() < 1e-11


@pytest.mark.slow
def test_second_call_gives_the_same_numbers_without_a_run(own_cache, monkeypatch):
    first = reference(oscillator())

    def forbidden(*_):
        raise AssertionError("it was computed again")

    monkeypatch.setattr(references, "execute", forbidden)
    second = reference(oscillator())
    assert second.run.columns == first.run.columns
    assert second.run.values.tobytes() == first.run.values.tobytes()
    assert (second.method, second.check, second.errors) == (first.method, first.check, first.errors)


@pytest.mark.slow
@pytest.mark.parametrize("damage", [b"", b"no archive", None])
def test_damaged_file_in_the_cache_is_computed_anew(own_cache, damage):
    first = reference(oscillator())
    (file,) = (own_cache / "references").iterdir()
    file.write_bytes(file.read_bytes()[:-200] if damage is None else damage)
    with pytest.warns(RuntimeWarning, match="was corrupt and has been rebuilt"):
        second = reference(oscillator())
    assert second.run.values.tobytes() == first.run.values.tobytes()


def test_key_depends_on_everything_that_changes_the_trajectory():
    scene = cosim.requested(oscillator())
    longer = cosim.requested(scene.dae, stop_time=11.0)
    finer = cosim.requested(scene.dae, output_interval=0.05)
    moved = cosim.requested(scene.dae, start_values={"x": 1.5})
    damped = cosim.requested(scene.dae, start_values={"b": 0.3})
    stiffer = cosim.requested(oscillator(0.3))
    later = cosim.requested(scene.dae, start_time=1.0)
    scenes = (scene, longer, finer, moved, damped, later)
    assert len({reference_key(s) for s in scenes}) == len(scenes)
    assert reference_key(stiffer) == reference_key(damped)
    assert reference_key(cosim.requested(oscillator())) == reference_key(scene)


def _ball(kept):
    model = Model("ball", stop_time=0.6, output_interval=0.1)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -10.0)
    model.when(h < 0, {v: -kept * v}, name="impact")
    return model.freeze()


@pytest.mark.parametrize("kept", [0.75, 0.5])
def test_models_that_differ_in_an_event_have_references_of_their_own(kept):
    """An impact at sqrt(0.2) s, at sqrt(20) m/s, lies before the last time."""
    after = 0.6 - np.sqrt(0.2)
    v = kept * np.sqrt(20) - 10 * after
    assert reference(_ball(kept)).run.final["v"] == pytest.approx(v, abs=1e-9)


@pytest.mark.slow
def test_formulations_of_one_model_have_one_reference():
    """DAE against ODE: other equations, other solvers."""
    ode, dae = (reference(catalogue.load(f"crank_shaft/{f}")) for f in ("driven", "multipliers"))
    for name in ("phi", "omega", "fx_A", "fy_A", "fx_B", "fy_B", "T", "energy"):
        apart = np.abs(ode.run[name] - dae.run[name]).max() / ode.run.column(name).nominal
        assert apart < 3 * (ode.errors[name] + dae.errors[name])  # measured 0 to 1.3


@pytest.mark.slow
def test_solution_that_does_not_exist_has_no_reference():
    with pytest.raises(
        SolverError, match=r"blow_up: no two methods agree on a reference; .*stopped"
    ):
        reference(blow_up())


def test_more_rows_than_fixed_steps_may_be_leave_the_reference_to_other_methods(
    monkeypatch, own_cache
):
    monkeypatch.setattr("cosim.integrate.families.fixed_step.MOST_UNROLLED_STEPS", 100)
    found = reference(oscillator(0.0))
    assert np.abs(found.run["x"] - np.cos(found.run.time)).max() < 1e-10
    assert "ode8" not in (found.method + found.check)
