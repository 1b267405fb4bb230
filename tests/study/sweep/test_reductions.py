"""Numbers of runs against closed forms."""

import numpy as np
import pytest

import cosim
from cosim.errors import UnknownName, UsageError
from cosim.series.curves import Rows, of_rows
from cosim.study.sweep.reductions import Keep, Reduction, keep_from

TIME = np.linspace(0, 2 * np.pi, 2001)
WAVES = np.array([[1.0], [2.0]]) * np.sin(TIME)


def test_numbers_of_a_sine_are_those_of_the_textbook():
    def of(kind, level=None):
        rows = of_rows(Rows(TIME, WAVES.T))
        return np.array([Reduction(kind, "x", level).of(rows, i) for i in range(2)])

    np.testing.assert_allclose(of("max"), [1, 2], rtol=1e-6)
    np.testing.assert_allclose(of("min"), [-1, -2], rtol=1e-6)
    np.testing.assert_allclose(of("rms"), np.array([1, 2]) / np.sqrt(2), rtol=1e-12)
    np.testing.assert_allclose(of("mean"), 0, atol=1e-14)
    np.testing.assert_allclose(of("final"), 0, atol=1e-14)
    np.testing.assert_allclose(of("first", 0.5), np.arcsin([0.5, 0.25]), rtol=1e-5)
    first = of("first", 1.5)
    assert np.isnan(first[0])  # never
    assert first[1] == pytest.approx(np.arcsin(0.75), rel=1e-5)
    np.testing.assert_array_equal(of("first", 0.0), [0, 0])


def test_words_name_the_results_to_store():
    kept = keep_from(["final", "max(b)", "first(a, 0.5)", "statistics"], ["a", "b"])
    assert [r.name for r in kept.reductions] == ["a_final", "b_final", "b_max", "a_first_0.5"]
    assert kept.statistics
    assert not kept.trajectories
    assert keep_from(kept.words(), ["a", "b"]) == kept
    assert keep_from([], ["a"]) == Keep(False, False, ())


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["maxx"], UnknownName),
        (["max(c)"], UnknownName),
        (["first(a)"], UsageError),
        (["max(a, 1)"], UsageError),
        ("final", UsageError),
        (["a+b"], UnknownName),
    ],
)
def test_other_words_are_rejected(words, error):
    with pytest.raises(error):
        keep_from(words, ["a", "b"])


@pytest.mark.parametrize("name", ["a[1,2]", "a[1].b", "der(x)", "a b"])
def test_names_of_fmus_are_read(name):
    words = [f"max({name})", f"first( {name} , -1e-3)"]
    kept = keep_from(words, ["a", name])
    assert kept.reductions == (Reduction("max", name), Reduction("first", name, -1e-3))
    assert keep_from(kept.words(), ["a", name]) == kept


@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_numbers_of_a_sweep_are_those_of_the_motion(solver):
    model = cosim.Model("oscillator", stop_time=1.0)
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", 0.0, "speed")
    rate = model.parameter("rate", "1/s", 1.0, "angular frequency")
    model.derivative(x, v)
    model.derivative(v, -(rate**2) * x)
    rates = 20 * np.pi * np.array([1.0, 2.0])  # each period ends at an output time
    keep = ["max", "min", "mean", "rms", "first(x, 0.5)"]
    found = cosim.sweep(
        model.freeze(), {"rate": rates}, keep=keep, solver=solver, output_interval=0.1, workers=0
    )
    np.testing.assert_allclose(found["x_min"], -1, rtol=1e-5)  # 1 at every output time
    np.testing.assert_allclose(found["x_max"], 1, rtol=1e-5)
    np.testing.assert_allclose(found["x_mean"], 0, atol=1e-6)
    np.testing.assert_allclose(found["x_rms"], np.sqrt(0.5), rtol=1e-5)
    np.testing.assert_allclose(found["x_first_0.5"], np.pi / 3 / rates, rtol=1e-6)


@pytest.mark.parametrize(("solver", "of_rows"), [("dop853", ""), ("rk4", " of the rows")])
def test_store_says_which_numbers_are_of_the_rows(solver, of_rows):
    run = {"stop_time": 0.1, "solver": solver, "workers": 0}
    found = cosim.sweep("crank_shaft", {"omega": [40, 50]}, keep=["max(phi)"], **run)
    assert found.to_xarray()["phi_max"].attrs["long_name"] == "max of phi" + of_rows
    assert ("; max of the rows" in repr(found)) is bool(of_rows)  # before: never
