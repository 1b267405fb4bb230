"""Arrays of FMI 3.0: their elements are variables, in every master and interface."""

import json
import math

import pytest
from helpers.fmu_files import with_description
from helpers.typed_part import typed_part

import cosim
from cosim.cli.main import main
from cosim.errors import FmuError, ParameterError, UnknownName, UsageError

EVERY = [(i, m) for i in ("ModelExchange", "CoSimulation") for m in ("fmpy", "c")]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return typed_part(tmp_path_factory.mktemp("typed"))


@pytest.fixture(params=EVERY, ids=["-".join(one) for one in EVERY])
def run(request, path):
    interface, master = request.param

    def simulate(outputs=("y",), **values):
        options = {"interface": interface, "master": master, "relative_tolerance": 1e-9}
        return cosim.simulate_fmu(path, start_values=values, outputs=outputs, **options).final

    return simulate


def test_outputs_are_recorded_by_their_elements(run):
    found = run(**{"u[1]": 1.0, "u[2]": 2.0})
    assert found == pytest.approx({"y[1]": 1.0, "y[2]": 2.0}, rel=1e-7)  # x' = u


def test_elements_of_a_matrix_are_set_and_the_others_stay(run):
    found = run(outputs=("x[2]", "A", "y[1]"), **{"A[1,2]": 2.0, "x[2]": 1.0, "u[2]": 1.0})
    assert list(found) == ["x[2]", "A[1,1]", "A[1,2]", "A[2,1]", "A[2,2]", "y[1]"]
    # x2 = 1 + t, x1' = 2 x2
    expected = {"x[2]": 2.0, "A[1,1]": 0, "A[1,2]": 2, "A[2,1]": 0, "A[2,2]": 0, "y[1]": 3.0}
    assert found == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("n", [0, 1, 2, 4])
def test_structural_parameter_gives_the_sizes(n, run):
    if n == 0:
        with pytest.raises(UsageError, match="y is not a single number and cannot be recorded"):
            run(n=n)
        return
    found = run(outputs=("y", "x"), **{"n": n, f"x[{n}]": 1.0, f"u[{n}]": 2.0})  # x' = 2 - x
    expected = dict.fromkeys([f"{v}[{i}]" for v in "yx" for i in range(1, n + 1)], 0.0)
    expected |= dict.fromkeys([f"y[{n}]", f"x[{n}]"], 2 - math.exp(-1))
    assert found == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize(
    ("values", "error", "reason"),
    [
        ({"u": 1.0}, UsageError, r"u is an array; name its elements, such as u\[1\]"),
        ({"A": 1.0}, UsageError, r"such as A\[1,1\]"),
        ({"u[3]": 1.0}, UnknownName, r"no start value 'u\[3\]'"),
        ({"u[0]": 1.0}, UnknownName, r"no start value 'u\[0\]'"),
        ({"n": 1, "u[2]": 1.0}, UnknownName, r"no start value 'u\[2\]'"),
        ({"n": 1.5}, ParameterError, "n = 1.5 is no UInt64"),
        ({"n": 5}, FmuError, "the FMU rejects n = 5 in configuration mode"),
        ({"n": 10**9}, FmuError, "its arrays have .* elements; give fewer"),
        ({"y[1]": 1.0}, UsageError, r"y\[1\] cannot be set; it is calculated"),
    ],
)
def test_wrong_element_or_size_is_rejected(values, error, reason, path):
    with pytest.raises(error, match=reason):
        cosim.simulate_fmu(path, start_values=values)


@pytest.mark.parametrize("interface", ["ModelExchange", "CoSimulation"])
def test_element_follows_a_series_and_the_others_stay(interface, path):
    run = cosim.simulate_fmu(
        path,
        interface=interface,
        relative_tolerance=1e-9,
        start_values={"u[1]": 3.0},
        inputs={"u[2]": "2*t"},
        outputs=["y", "u"],
    )
    expected = {"y[1]": 3.0, "y[2]": 1.0, "u[1]": 3.0, "u[2]": 2.0}
    assert run.final == pytest.approx(expected, rel=1e-6)
    assert run.units["u[2]"] == "m/s"


def test_command_line_names_elements(path, tmp_path, capsys):
    table = tmp_path / "inputs.csv"
    table.write_text("time,u[1]\n0,1\n1,1\n")
    options = ["--trust", "--outputs", "A[1,2],y", "-p", "A[1,2]=2", "-p", "x[2]=1"]
    assert main(["simulate", str(path), *options, "--input-file", str(table)]) == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert header == 'time,"A[1,2]",y[1],y[2]'
    assert [float(n) for n in rows[-1].split(",")] == pytest.approx([1, 2, 3, 1], rel=1e-7)


def test_info_shows_the_sizes_of_arrays(path, capsys):
    assert main(["info", str(path)]) == 0
    shown = {line.split()[0] for line in capsys.readouterr().out.splitlines() if line}
    assert {"n", "A[1..2,1..2]", "u[1..2]", "y[1..2]"} <= shown
    assert main(["info", str(path), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["output"][:1]
    assert (row["name"], row["dimensions"]) == ("y", [2])


@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_growth_is_followed_in_a_file_without_a_reset(path, master):
    """The sum of the states grows by x' = 5 x + 1e-13."""
    values = {"A[1,2]": 5.0, "A[2,1]": 5.0, "u[1]": 1e-13}
    options = {"interface": "ModelExchange", "master": master, "relative_tolerance": 1e-8}
    run = cosim.simulate_fmu(
        path, start_values=values, outputs=["x"], stop_time=8, output_interval=0.5, **options
    )
    right = 1e-13 / 10 * math.expm1(40)  # each is a half
    assert run.final["x[1]"] == pytest.approx(right, rel=1e-4)  # before: 1e18 times as much


def test_a_derivative_of_another_shape_than_its_state_is_rejected(path, tmp_path):
    def edit(root):
        state = root.find("ModelVariables/*[@name='x']")
        state.remove(state.find("Dimension"))

    damaged = with_description(path, tmp_path / "damaged.fmu", edit)
    with pytest.raises(FmuError, match=r"is the derivative of x, but of another shape; give both"):
        cosim.simulate_fmu(damaged)
