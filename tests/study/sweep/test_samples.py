"""Samples from tables, grids and designs."""

import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.study.sweep.samples import (
    Samples,
    as_samples,
    chosen_samples,
    design,
    grid,
    read_samples,
)


def test_a_grid_has_every_combination_and_its_last_name_varies_fastest():
    found = grid({"g": [1.62, 9.81], "phi": [0, 1, 2]})
    assert found.columns["g"].tolist() == [1.62] * 3 + [9.81] * 3
    assert found.columns["phi"].tolist() == [0, 1, 2, 0, 1, 2]


def test_samples_from_a_file_have_its_numbers_bit_for_bit(tmp_path):
    random = np.random.default_rng(1)
    samples = Samples({"a": random.normal(size=50), "b": random.normal(size=50) * 1e-300})
    rows = zip(*(column.tolist() for column in samples.columns.values()), strict=True)
    lines = ["a,b", *(",".join(map(repr, row)) for row in rows)]
    (tmp_path / "s.csv").write_text("\n".join(lines))
    again = read_samples(tmp_path / "s.csv")
    assert again.digest == samples.digest
    np.testing.assert_array_equal(again.columns["b"], samples.columns["b"])


def test_samples_may_have_decimal_commas(tmp_path):
    (tmp_path / "s.csv").write_text("sep=;\na;b\n1,5;2\n2;-3,5e-1\n")
    columns = read_samples(tmp_path / "s.csv").columns
    assert [own.tolist() for own in columns.values()] == [[1.5, 2], [2, -0.35]]


def test_single_values_hold_for_every_row_of_a_table():
    found = chosen_samples({"g": 9.81}, {"phi": [0, 1, 2]})
    assert found.columns["g"].tolist() == [9.81] * 3
    with pytest.raises(UsageError, match="one value for all runs"):
        chosen_samples({"g": [1, 2, 3]}, {"phi": [0, 1, 2]})
    with pytest.raises(UsageError, match="give it once"):
        chosen_samples({"phi": 1}, {"phi": [0, 1, 2]})
    with pytest.raises(UsageError, match="not both"):
        chosen_samples({"phi": (0, 1)}, {"phi": [0, 1, 2]}, "sobol:4")


def test_a_design_by_name_is_the_one_of_its_function():
    ranges = {"a": (2.0, 3.0), "b": 7.0}
    assert chosen_samples(ranges, None, "random:8").digest == design("random", 8, ranges).digest
    axes = {"a": [1, 2], "b": [3, 4]}
    assert chosen_samples(axes, None, "grid").digest == grid(axes).digest
    with pytest.raises(UsageError, match="KIND:N"):
        chosen_samples(ranges, None, "sobol")


def test_number_of_sobol_samples_that_is_no_power_of_2_names_the_next_ones():
    with pytest.warns(UserWarning, match="sobol") as notes:
        assert len(design("sobol", 100, {"m": (0.0, 1.0)})) == 100
    (note,) = notes  # of SciPy there is none
    assert str(note.message) == "sweep: 100 sobol samples are unevenly spread; give 64 or 128"


@pytest.mark.parametrize("kind", ["sobol", "lhs", "halton", "random"])
def test_a_design_fills_its_ranges_and_repeats_with_its_seed(kind):
    pytest.importorskip("scipy")
    ranges = {"a": (2.0, 3.0), "b": 7.0, "c": (-1.0, 1.0)}
    found = design(kind, 64, ranges, seed=4)
    assert design(kind, 64, ranges, seed=4).digest == found.digest
    assert design(kind, 64, ranges, seed=5).digest != found.digest
    assert (found.columns["b"] == 7).all()
    a = found.columns["a"]
    assert 2 <= a.min() < 2.2
    assert 2.8 < a.max() <= 3
    if kind in ("sobol", "lhs"):  # one sample in each 64th
        assert sorted(np.floor((a - 2) * 64).astype(int)) == list(range(64))


def test_a_single_number_of_any_type_stays_the_same_in_all_runs():
    for number in (7, 7.0, np.int64(7), np.float32(7)):
        found = design("random", 3, {"a": (2.0, 3.0), "b": number})
        assert found.columns["b"].tolist() == [7.0, 7.0, 7.0]


def test_a_design_follows_a_distribution():
    stats = pytest.importorskip("scipy.stats")
    found = design("sobol", 1024, {"m": stats.norm(80, 5)})
    assert found.columns["m"].mean() == pytest.approx(80, abs=0.05)
    assert found.columns["m"].std() == pytest.approx(5, rel=0.01)


def test_malformed_tables_and_designs_are_rejected(tmp_path):
    with pytest.raises(UsageError, match="CSV file"):
        as_samples(3)
    with pytest.raises(ParameterError, match="there are none"):
        as_samples({})
    with pytest.raises(ParameterError, match="others have"):
        as_samples({"a": [1, 2], "b": [1, 2, 3]})
    file = tmp_path / "bad.csv"
    for text, expected in (
        ("a,b\n1\n", "line 2: 1 cells"),
        ("a\nx\n", "line 2, column .a.: .x. is not a number"),
        ("a,a\n1,2\n", "twice"),
    ):
        file.write_text(text)
        with pytest.raises(ParameterError, match=expected):
            read_samples(file)
    with pytest.raises(UnknownName, match="sobol"):
        design("sobbol", 4, {"a": (0, 1)})
    with pytest.raises(ParameterError, match="no range"):
        design("random", 4, {"a": (1, 0)})


def test_a_range_may_be_longer_than_the_largest_number():
    found = design("random", 64, {"a": (-1e308, 1e308)}).columns["a"]
    same = design("random", 64, {"a": (-1.0, 1.0)}).columns["a"]
    np.testing.assert_allclose(found / 1e308, same, rtol=0, atol=1e-15)


def test_quantities_have_names_of_their_own_among_results():
    samples = Samples({"run": [1.0], "run_start": [2.0], "m": [3.0]})
    names = samples.distinct_names({"run", "m"})
    assert names == {"run": "run_start_start", "run_start": "run_start", "m": "m_start"}
    model = Model("growth", stop_time=1.0)
    rates = [model.parameter(name, "1", 1.0, "rate") for name in ("steps", "steps_start")]
    model.derivative(model.state("x", "1", 0.0, "sum"), rates[0] + 10 * rates[1])
    found = cosim.sweep(model.freeze(), {"steps": [1.0], "steps_start": [2.0]}, workers=0)
    (row,) = found.rows()  # before: one of the two replaced the other, or it was rejected
    assert (row["steps_start_start"], row["steps_start"]) == (1.0, 2.0)
    assert row["x_final"] == pytest.approx(21.0, rel=1e-12)
