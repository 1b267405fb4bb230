"""`cosim.fit`: values, their confidence, and what the measurements cannot identify."""

import numpy as np
import pytest
from helpers.fmu_files import set_attributes, with_description
from helpers.measured_decay import DECAY, TIMES, noisy, record

import cosim
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.series.samples import Column
from cosim.study.fit.fit import fit
from cosim.trajectory import Trajectory


def linear_theory(k=2.0, start=3.0, size=0.05):
    """Covariance of k and the start value by the Cramer-Rao bound."""
    jacobian = np.column_stack((-start * TIMES * np.exp(-k * TIMES), np.exp(-k * TIMES)))
    return size**2 * np.linalg.inv(jacobian.T @ jacobian)


def test_exact_record_gives_the_values_that_made_it():
    found = fit(DECAY, noisy(0, size=0.0), {"k": (0.1, 10.0), "x": None})
    assert found.values == pytest.approx({"k": 2.0, "x": 3.0}, rel=1e-6)  # measured 4e-9
    assert found.rank == 2
    assert not found.unidentified


@pytest.mark.parametrize("size", [1.0, 1e9, 1e12])
def test_a_minimum_that_is_far_from_the_first_values_is_reached(size):
    """phi = omega t + alpha t^2 / 2 is linear in both, so that least squares are exact."""
    noise = np.random.default_rng(0).normal(0, 0.5, len(TIMES))
    phi = size * (50 * TIMES + 5 * TIMES**2 + noise)
    measured = Trajectory("far", TIMES, (Column("phi", "rad"),), phi[:, None])
    table = np.column_stack((TIMES**2 / 2, TIMES))
    exact, (squares,), *_ = np.linalg.lstsq(table, phi, rcond=None)
    errors = np.sqrt(np.diag(squares / (len(TIMES) - 2) * np.linalg.inv(table.T @ table)))
    found = fit("crank_shaft", measured, ["alpha", "omega"])
    values = np.array([found.values[name] for name in ("alpha", "omega")])
    assert (np.abs(values - exact) / errors).max() < 1e-5  # measured 1e-7
    own = [found.errors[name] for name in ("alpha", "omega")]
    np.testing.assert_allclose(own, errors, rtol=1e-5)
    assert found.notes == ()


def test_a_minimum_that_is_not_reached_is_noted(monkeypatch):
    far = record({"x": 1e200 * np.exp(-TIMES)})
    with pytest.raises(ParameterError, match="the squares of these measurements have no size"):
        fit(DECAY, far, {"x": 1.0, "k": 1.0})
    monkeypatch.setattr("cosim.study.fit.fit.FURTHER", 1)  # minimizer's runs
    measured = Trajectory("far", TIMES, (Column("phi", "rad"),), 1e140 * TIMES[:, None])
    found = fit("crank_shaft", measured, ["alpha", "omega"])
    assert any("the fit did not converge: the minimum is about" in note for note in found.notes)


# Measured records of the Statistical Reference Datasets (NIST, nonlinear regression) of
# y = b1 (1 - exp(-b2 x)): x, y, then b1, b2, their standard deviations and that of the residuals as
# certified there, and where the fit begins
ADSORPTION = (  # Misra1a: dental research, volume over pressure
    "77.6 114.9 141.1 190.8 239.9 289 332.8 378.4 434.8 477.3 536.8 593.1 689.1 760",
    "10.07 14.73 17.94 23.93 29.61 35.18 40.02 44.82 50.76 55.05 61.01 66.4 75.47 81.78",
    (238.94212918, 5.5015643181e-4),
    (2.7070075241, 7.2668688436e-6),
    0.1018787633,
    (250.0, 5e-4),
)
OXYGEN_DEMAND = (  # BoxBOD: biochemical oxygen demand, mg/l over days
    "1 2 3 5 7 10",
    "109 149 149 191 213 224",
    (213.80940889, 0.54723748542),
    (12.354515176, 0.10455993237),
    17.088072423,
    (100.0, 0.75),
)


@pytest.mark.slow
@pytest.mark.parametrize("published", [ADSORPTION, OXYGEN_DEMAND], ids=["Misra1a", "BoxBOD"])
def test_published_records_have_their_certified_values(published):
    *texts, values, errors, residual, begin = published
    x, y = (np.array(text.split(), dtype=float) for text in texts)
    model = cosim.Model("uptake", stop_time=float(x[-1]))
    taken = model.state("y", "1", 0.0, "y")
    limit = model.parameter("b1", "1", begin[0], "limit")
    model.derivative(taken, model.parameter("b2", "1/s", begin[1], "rate") * (limit - taken))
    measured = Trajectory("published", x, (Column("y", "1"),), y[:, None])
    found = fit(model.freeze(), measured, {"b1": None, "b2": None})
    assert [*found.values.values()] == pytest.approx(values, rel=1e-6)  # measured 3e-7
    assert [*found.errors.values()] == pytest.approx(errors, rel=1e-5)  # measured 3e-6
    assert found.noise["y"] == pytest.approx(residual, rel=1e-5)


@pytest.mark.slow
def test_values_of_many_records_have_the_covariance_of_the_cramer_rao_bound():
    found = [fit(DECAY, noisy(seed), {"k": 1.0, "x": 1.0}) for seed in range(20)]
    bound = linear_theory()
    truth = np.array([2.0, 3.0])
    apart = np.array([one.x - truth for one in found])
    normalized = np.einsum("ri,ij,rj->r", apart, np.linalg.inv(bound), apart)
    assert 0.8 < normalized.mean() < 3.5  # of chi squared with 2 degrees: 2
    sizes = np.mean([np.diag(one.covariance) for one in found], axis=0)
    np.testing.assert_allclose(sizes, np.diag(bound), rtol=0.2)
    inside = [
        low <= value <= high
        for one in found
        for (low, high), value in zip(one.intervals.values(), truth, strict=True)
    ]
    assert np.mean(inside) >= 0.85  # of 95 %


@pytest.mark.slow
def test_restitution_of_a_bouncing_ball_is_found_through_its_impacts():
    model = cosim.Model("ball", stop_time=2.0)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    e = model.parameter("restitution", "1", 0.7, "restitution")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -e * v}, name="impact")
    dae, times = model.freeze(), np.linspace(0, 1.0, 51)
    truth = cosim.simulate(dae, start_values={"restitution": 0.8}, output_times=times)
    measured = truth.select(["h"])
    found = fit(dae, measured, {"restitution": (0.5, 0.75, 0.95)})
    assert found.values["restitution"] == pytest.approx(0.8, abs=1e-7)  # measured 1e-10


@pytest.mark.parametrize("at_jump", [True, False])
def test_a_measurement_at_a_jump_is_named(at_jump):
    """x = k t, and y jumps where x exceeds 1: at t = 1 +- the error of k."""
    model = cosim.Model("switch", stop_time=2.0)
    x, k = model.state("x", "m", 0.0, "way"), model.parameter("k", "m/s", 0.9, "speed")
    y = model.discrete("y", "m", 0.0, "whether the way is long")
    model.derivative(x, k)
    model.when(x > 1, {y: 1.0}, name="far")
    times = np.linspace(0, 2, 21) + (0 if at_jump else 0.05)
    noise = 0.01 * np.random.default_rng(1).normal(size=21)
    measured = {"x": times + noise, "y": (times >= 1) * 1.0}
    columns = (Column("x", "m"), Column("y", "m"))
    record = cosim.Trajectory("r", times, columns, np.transpose([*measured.values()]))
    found = fit(model.freeze(), record, {"k": (0.9, 1.02, 1.1)}, noise={"x": 0.01, "y": 0.01})
    assert found.values["k"] == pytest.approx(1, abs=0.01)
    named = "a jump comes before or after 1 measurement, the first at 1 s"
    assert any(note.startswith(named) for note in found.notes) == at_jump
    assert any("a jump" in note for note in found.notes) == at_jump


@pytest.mark.slow
def test_product_of_two_values_is_identified_and_not_its_factors():
    y = record({"y": 6.0 * np.exp(-2.0 * TIMES)})
    found = fit(DECAY, y, {"k": 1.0, "scale": 2.0, "share": 2.0})
    assert found.rank == 2
    (sentence,) = found.unidentified
    assert sentence.startswith("not identified: of scale, share only 1 combination; fix 1")
    assert found.errors["scale"] == np.inf
    assert found.errors["k"] < 1e-3
    assert found.values["scale"] * found.values["share"] == pytest.approx(6.0, rel=1e-6)


def test_value_without_influence_is_named():
    found = fit(DECAY, noisy(1), ["k", "idle"], start_values={"x": 3.0})
    assert found.unidentified == ("not identified: idle (the measurements do not depend on it)",)
    assert np.isfinite(found.errors["k"])


def test_gaps_are_left_out_and_several_records_count_together():
    first, second = noisy(2), noisy(3)
    values = first.values.copy()
    values[5:20] = np.nan
    gapped = Trajectory("gapped", first.time, first.columns, values)
    found = fit(DECAY, [gapped, second], {"k": 1.0, "x": 1.0})
    assert found.samples == 2 * len(TIMES) - 15
    assert len(found.runs) == 2
    assert found.values == pytest.approx({"k": 2.0, "x": 3.0}, rel=0.05)


def test_start_values_of_each_record_are_its_own():
    records = [noisy(seed, start=start) for seed, start in ((2, 3.0), (3, -1.0), (4, 5.0))]
    found = fit(DECAY, records, {"x": 1.0, "k": (0.1, 10.0)}, each=["x"])
    names = [f"x (record {number})" for number in (1, 2, 3)]
    assert list(found.values) == [*names, "k"]
    assert list(found.values.values()) == pytest.approx([3.0, -1.0, 5.0, 2.0], rel=0.03)
    assert [run["x"][0] for run in found.runs] == [found.values[name] for name in names]
    assert found.noise["x"] == pytest.approx(0.05, rel=0.1)
    assert found.rank == 4
    again = fit(DECAY, records[0], {"k": 1.0, "x": 1.0}, each=["x"])
    assert list(again.values) == ["k", "x"]
    assert cosim.simulate(found.dae, stop_time=0.1).values[0, 0] == found.values[names[0]]


def test_robust_loss_is_not_moved_by_outliers():
    outliers = noisy(4)
    values = outliers.values.copy()
    values[::8] += 2.0
    spoiled = Trajectory("spoiled", outliers.time, outliers.columns, values)
    plain, robust = (
        fit(DECAY, spoiled, {"k": 1.0, "x": 1.0}, loss=loss).values["k"]
        for loss in ("linear", "cauchy")
    )
    assert abs(robust - 2.0) < 0.1 < abs(plain - 2.0)


def test_each_output_is_weighted_by_its_own_noise():
    generator = np.random.default_rng(5)
    exact = 3.0 * np.exp(-2.0 * TIMES)
    both = record(
        {
            "x": exact + generator.normal(0, 0.5, len(TIMES)),
            "y": exact + generator.normal(0, 0.01, len(TIMES)),
        }
    )
    found = fit(DECAY, both, {"k": 1.0, "x": 1.0})
    assert found.noise == pytest.approx({"x": 0.5, "y": 0.01}, rel=0.3)
    given = fit(DECAY, both, {"k": 1.0, "x": 1.0}, noise={"x": 0.5, "y": 0.01})
    assert given.noise == {"x": 0.5, "y": 0.01}
    assert given.values == pytest.approx(found.values, rel=1e-2)


@pytest.mark.slow
def test_several_starts_find_the_frequency_that_one_misses():
    model = cosim.Model("wave", stop_time=2.0)
    x, v = model.state("x", "m", 1.0, "x"), model.state("v", "m/s", 0.0, "v")
    w = model.parameter("w", "rad/s", 2.0, "frequency")
    model.derivative(x, v)
    model.derivative(v, -(w**2) * x)
    dae, wave = model.freeze(), record({"x": np.cos(20 * TIMES)})
    assert abs(fit(dae, wave, {"w": (1.0, 2.0, 40.0)}).values["w"] - 20) > 1
    assert fit(dae, wave, {"w": (1.0, 40.0)}, starts=16).values["w"] == pytest.approx(20, abs=1e-6)


def test_errors_beside_a_value_at_its_bound_are_those_with_this_value_known():
    """With k = 1, x is found from one linear equation: the error is sigma / |exp(-t)|."""
    measured, shape = noisy(6), np.exp(-TIMES)
    found = fit(DECAY, measured, {"k": (0.1, 1.0), "x": None})
    assert found.values["k"] == pytest.approx(1.0, rel=1e-5)
    assert found.notes[0].startswith("k ends at its bound 1 1/s and has no error")
    x = shape @ measured["x"] / (shape @ shape)
    left = np.linalg.norm(measured["x"] - x * shape)
    error = left / np.sqrt((len(TIMES) - 1) * (shape @ shape))
    assert found.errors["x"] == pytest.approx(error, rel=1e-4)  # before: 1.7 times as large
    half = 2.02108 * error  # Student's quantile of 40 degrees
    assert found.intervals["x"] == pytest.approx((x - half, x + half), rel=1e-4)
    assert np.isnan([found.errors["k"], *found.intervals["k"], found.correlation[0, 1]]).all()
    assert "nan" not in repr(found)
    assert found.rank == 1


def test_value_at_its_bound_that_the_measurements_do_not_show_is_not_identified():
    found = fit(DECAY, noisy(1), {"k": None, "idle": (0.0, 1.0, 1.0 + 1e-9)}, start_values={"x": 3})
    assert found.unidentified == ("not identified: idle (the measurements do not depend on it)",)
    assert found.errors["idle"] == np.inf


def test_the_bound_itself_is_named_although_the_value_ends_beside_it():
    """A constant is fitted best by the rate 0, where the least squares end close to the bound."""
    found = fit(DECAY, record({"x": np.ones_like(TIMES)}), {"k": (0.0, 0.5, 10.0)})
    assert found.values["k"] == pytest.approx(0, abs=1e-6)  # measured 2e-7
    assert [note[:27] for note in found.notes] == ["k ends at its bound 0 1/s a"]


def test_a_bound_is_named_in_the_unit_of_the_value():
    run = cosim.simulate("bar_on_frame", stop_time=1, outputs=["theta"])
    pound = 1.3558179483314004  # N.m in a ft.lbf
    found = fit("bar_on_frame", run, {"b": (0.1 * pound, pound)})
    assert found.rows()[0]["value"] == "0.1"
    assert found.notes[0].startswith("b ends at its bound 0.1 ft.lbf.s/rad and has no error")


def test_rate_of_what_stays_at_zero_is_not_identified():
    found = fit(DECAY, record({"x": np.zeros_like(TIMES)}), {"k": (0.1, 10.0), "x": (-1, 0.5, 10)})
    assert found.values["x"] == pytest.approx(0, abs=1e-12)
    assert found.unidentified == ("not identified: k (the measurements do not depend on it)",)


def test_record_that_begins_late_is_noted():
    late = record({"x": 3 * np.exp(-2 * TIMES)}, TIMES + 2.5, "late")
    (note,) = fit(DECAY, late, {"k": (0.1, 10.0)}).notes
    assert note.startswith("late begins 2.5 s after the run, which begins at 0")
    late = record({"x": 3 * np.exp(-2 * TIMES)}, TIMES + 2.0)
    assert not fit(DECAY, late, {"k": (0.1, 10.0)}).notes


def test_records_of_different_variables_are_summed_up():
    other = record({"y": 3 * np.exp(-2 * TIMES)})
    found = fit(DECAY, [noisy(1), other], {"k": (0.1, 10.0), "x": None})
    assert "residuals (standard deviation): x 0.0" in str(found)
    assert ", y " in str(found)


def test_fitted_model_starts_with_the_fitted_values():
    found = fit(DECAY, noisy(7), {"k": 1.0, "x": 1.0})
    assert found.dae.variable("k").start == found.values["k"]
    again = cosim.simulate(found.dae, output_times=TIMES, outputs=["x"])
    np.testing.assert_allclose(again["x"], found.runs[0]["x"], rtol=1e-6)
    assert found.compare(bound=0.2).agrees


def test_error_of_a_temperature_is_shown_as_a_difference():
    """Of the mean of n temperatures, shown in degC: its error in K is that in degC."""
    model = cosim.Model("still", stop_time=2.0)
    warmth = model.state("warmth", "K", 293.15, "warmth", display_unit="degC")
    model.derivative(warmth, 0 * warmth)
    kelvin = 293.15 + np.random.default_rng(0).normal(0, 0.1, len(TIMES))
    measured = Trajectory("still", TIMES, (Column("warmth", "K"),), kelvin[:, None])
    (row,) = fit(model.freeze(), measured, {"warmth": 290.0}).rows()
    assert float(row["value"]) == pytest.approx(kelvin.mean() - 273.15, abs=1e-4)
    assert row["error"] == pytest.approx(kelvin.std(ddof=1) / np.sqrt(len(TIMES)), rel=1e-6)


@pytest.mark.parametrize("scale", [1e-20, 1e-12, 1e12])
def test_errors_of_a_fit_do_not_depend_on_the_size_of_what_is_measured(scale):
    noise = np.random.default_rng(3).normal(0, 0.01, len(TIMES))
    measured = record({"x": scale * (np.exp(-2 * TIMES) + noise)})
    found = fit(DECAY, measured, {"k": 1.0}, start_values={"x": scale})
    usual = fit(DECAY, record({"x": measured["x"] / scale}), {"k": 1.0})
    assert found.values == pytest.approx(usual.values, rel=1e-6)
    assert found.errors == pytest.approx(usual.errors, rel=1e-4)  # before: 1 of 1e-12 m for 1e-2


@pytest.mark.parametrize(("low", "start"), [(0.03, 0.41), (0.05, 0.67), (0.05, 0.19)])
def test_a_value_ends_at_its_bound_whatever_its_scale_rounds_to(low, start):
    assert low / start * start < low
    model = cosim.Model("bounded", stop_time=2.0)
    x, k = model.state("x", "m", 1.0, "x"), model.parameter("k", "1/s", 0.5, "rate", minimum=low)
    model.derivative(x, -k * x)
    measured = record({"x": np.exp(-(low - 1e-9) * TIMES[::2])}, TIMES[::2])
    found = fit(model.freeze(), measured, {"k": start}, solver="dop853")
    assert found.values["k"] == pytest.approx(low, abs=1e-7)


@pytest.mark.slow
def test_fmu_with_a_start_time_of_its_own_is_fitted_from_0(tmp_path):
    path = cosim.export_fmu(DECAY, tmp_path / "decay.fmu")
    edit = set_attributes("DefaultExperiment", startTime="5", stopTime="7")
    late = with_description(path, tmp_path / "late.fmu", edit)
    found = fit(late, noisy(8, size=0), {"k": 1.0}, start_values={"x": 3.0})
    assert found.values["k"] == pytest.approx(2.0, rel=1e-6)


def test_fmu_whose_value_ends_at_its_bound_is_not_run_beyond_it(tmp_path):
    """A constant is fitted best by the lowest rate."""
    found = []
    for low in (0.0, 1.5):
        model = cosim.Model("bounded", stop_time=2.0)
        x = model.state("x", "m", 1.0, "x")
        k = model.parameter("k", "1/s", 2.0, "rate", minimum=low)
        model.derivative(x, -k * x)
        path = cosim.export_fmu(model.freeze(), tmp_path / "bounded.fmu")
        found.append(fit(path, record({"x": 2 + 0.01 * TIMES}), {"k": None, "x": None}))
    assert [one.values["k"] for one in found] == pytest.approx([0, 1.5], abs=1e-6)
    for one, bound in zip(found, ("0", "1.5"), strict=True):
        text = f"k ends at its bound {bound} 1/s"
        assert [note[: len(text)] for note in one.notes] == [text]
    assert found[0].values["x"] == pytest.approx(2 + 0.01 * TIMES.mean(), rel=1e-6)


@pytest.mark.slow
def test_fmu_is_fitted_by_finite_differences(tmp_path):
    path = cosim.export_fmu(DECAY, tmp_path / "decay.fmu")
    found = fit(path, noisy(8), {"k": (0.1, 10.0), "x": 1.0})
    model = fit(DECAY, noisy(8), {"k": (0.1, 10.0), "x": 1.0})
    assert found.values == pytest.approx(model.values, rel=1e-4)
    assert found.subject.derivatives.startswith("finite differences")
    with pytest.raises(UsageError, match="there is no model of it"):
        found.scene()
    once = record({"x": [3 * np.exp(-2.0)], "y": [3 * np.exp(-2.0)]}, [1.0])
    assert fit(path, once, {"k": 1.0}, start_values={"x": 3.0}).values["k"] == pytest.approx(
        2.0, rel=1e-4
    )


@pytest.mark.parametrize(
    ("changed", "error", "text"),
    [
        ({"parameters": {"kk": None}}, UnknownName, "did you mean k"),
        ({"parameters": {}}, UsageError, "nothing is unknown; name what to fit: parameters="),
        ({"parameters": "k"}, UsageError, "parameters"),
        ({"parameters": {"k": (2.0, 1.0)}}, ParameterError, r"give \(low, high\)"),
        ({"parameters": {"k": np.nan}}, ParameterError, "not finite"),
        ({"parameters": ["k"], "start_values": {"k": 1.0}}, UsageError, "give it once"),
        ({"parameters": ["k"], "starts": 3}, ParameterError, "need bounds of k"),
        ({"parameters": ["k"], "starts": 0}, ParameterError, "1 or more"),
        ({"parameters": ["k"], "each": ["x"]}, UnknownName, "fit: each has no unknown 'x'"),
        (
            {"parameters": ["k"], "each": "k"},
            UsageError,
            "fit: each was given 'k'.*a list of names",
        ),
        ({"parameters": ["k"], "loss": "hubber"}, UnknownName, "did you mean huber"),
        ({"parameters": ["k"], "noise": {"x": 0.0}}, ParameterError, "not positive"),
        ({"parameters": ["k"], "noise": {"z": 1.0}}, UnknownName, "measured variable"),
        ({"parameters": ["k"], "confidence": 1.0}, ParameterError, "between 0 and 1"),
        ({"measured": []}, UsageError, "measured"),
        ({"measured": record({"q": TIMES})}, UnknownName, "q"),
        ({"measured": record({"x": TIMES[:1]}, TIMES[:1])}, ParameterError, "cannot determine"),
        ({"measured": record({"x": TIMES}, TIMES - 1)}, ParameterError, "before the run"),
        (
            {"measured": record({"x": TIMES}, np.fmax(TIMES, 0.05))},
            ParameterError,
            "two measurements at 0.05 s",
        ),
    ],
)
def test_wrong_arguments_are_rejected(changed, error, text):
    options = {"measured": noisy(0), "parameters": ["k"], **changed}
    with pytest.raises(error, match=text):
        fit(DECAY, options.pop("measured"), options.pop("parameters"), **options)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_figure_shows_every_record(count):
    records = [noisy(seed, start=float(seed + 1)) for seed in range(count)]
    found = fit(DECAY, records, {"k": 1.0, "x": 1.0}, each=["x"] if count > 1 else ())
    shown = [axis for axis in found.plot().axes if axis.axison]
    assert len(shown) == 2 * count  # curves and residuals
    measured = [axis.lines[1].get_ydata() for axis in shown if len(axis.lines) == 2]
    for one in records:
        assert any(np.array_equal(values, one["x"]) for values in measured)
    assert len(found.plot(record=count - 1).axes) == 2


def test_figure_of_records_with_different_variables_leaves_their_panels_empty():
    records = [noisy(0), record({"y": 3 * np.exp(-2 * TIMES)})]
    found = fit(DECAY, records, {"k": 1.0, "x": 1.0})
    shown = [axis.get_ylabel() for axis in found.plot().axes if axis.axison]
    assert len(shown) == 4
    assert {name for name in shown if name} == {"x [m]", "y [m]", "residual [m]"}


def test_value_that_is_almost_zero_is_identified():
    """The measurements show an offset of 1e-8 m as well as one of 1 m."""
    model = cosim.Model("offset", stop_time=2.0)
    x = model.state("x", "m", 1.0, "x")
    k = model.parameter("k", "1/s", 1.0, "rate")
    offset = model.parameter("offset", "m", 0.0, "offset")
    model.derivative(x, -k * x)
    model.output("y", "m", x + offset, "y")
    noise = np.random.default_rng(4).normal(0, 1e-8, len(TIMES))
    found = fit(model.freeze(), record({"y": np.exp(-2 * TIMES) + noise}), ["k", "offset"])
    jacobian = np.column_stack((-TIMES * np.exp(-2 * TIMES), np.ones_like(TIMES)))
    errors = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))) * found.noise["y"]
    assert not found.unidentified
    assert list(found.errors.values()) == pytest.approx(errors, rel=1e-4)
    assert abs(found.values["offset"]) < 4 * errors[1]
