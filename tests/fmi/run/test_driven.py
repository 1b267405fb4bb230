"""Inputs of FMUs: formulas, functions, samples and files, against integrals in closed form."""

import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.cli.main import main
from cosim.errors import FmuError, UnknownName, UsageError

FREQUENCY = 3.0
LAW = "2*sin(3*t)"
KINDS = ["ModelExchange", "CoSimulation"]


@pytest.fixture(scope="module")
def integrator(tmp_path_factory):
    model = Model("integrator", description="x' = u + w", source="a test", stop_time=1.0)
    x = model.state("x", "m", 0.0, "integral")
    u, w = model.input("u", "m/s", 0.0, "rate"), model.input("w", "m/s", 0.0, "another rate")
    model.derivative(x, u + w)
    return cosim.export_fmu(model.freeze(), tmp_path_factory.mktemp("fmu") / "integrator.fmu")


def exact(time):
    return 2 / FREQUENCY * (1 - np.cos(FREQUENCY * time))


STRAIGHT = 1.1e-4  # h^2/12 (f'(1) - f'(0)) of straight lines is 9.95e-5, and measured


@pytest.mark.parametrize("interface", KINDS)
@pytest.mark.parametrize(
    ("law", "exactly"),
    [
        (LAW, True),
        (lambda t: 2 * np.sin(FREQUENCY * t), True),
        (2 * np.sin(FREQUENCY * np.linspace(0, 1, 101)), False),
    ],
    ids=["formula", "function", "samples"],
)
def test_law_is_followed_as_accurately_as_the_interface_can(integrator, interface, law, exactly):
    run = cosim.simulate_fmu(
        integrator, interface=interface, inputs={"u": law}, relative_tolerance=1e-8
    )
    follows = exactly and interface == "ModelExchange"
    bound = 1e-6 if follows else STRAIGHT  # measured 2.2e-7 of fmpy's CVODE
    assert np.abs(run["x"] - exact(run.time)).max() < bound


@pytest.mark.slow_rows("3-text-ModelExchange")
@pytest.mark.parametrize("interface", KINDS)
@pytest.mark.parametrize("law", [LAW, lambda t: 2 * np.sin(FREQUENCY * t)], ids=["text", "call"])
def test_output_that_depends_on_an_input_follows_it_exactly(lag, interface, law):
    run = cosim.simulate_fmu(lag[1], interface=interface, inputs={"u": law}, output_interval=0.17)
    expected = 4 * np.sin(FREQUENCY * run.time)
    np.testing.assert_allclose(run["fed_through"], expected, rtol=0, atol=1e-14)  # measured 4e-16


def test_file_and_formula_drive_two_inputs_at_once(integrator, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ramp.csv").write_text('"time","w"\n0,0\n1,1\n')
    line = ["simulate", str(integrator), "--trust", "--interface-type", "ModelExchange"]
    line += ["--input-file", "ramp.csv", "--input", f"u={LAW}", "-o", "run.csv"]
    assert main([*line, "--relative-tolerance", "1e-8"]) == 0, capsys.readouterr().err
    run = cosim.Trajectory.read_csv("run.csv")
    np.testing.assert_allclose(run["x"], exact(run.time) + run.time**2 / 2, atol=1e-6)


def test_constant_input_of_a_mapping_is_a_constant(integrator):
    run = cosim.simulate_fmu(integrator, inputs={"u": 0.5}, start_values={"w": 0.25})
    assert run.final["x"] == pytest.approx(0.75, abs=1e-9)


@pytest.mark.parametrize(
    ("inputs", "start", "kind", "told"),
    [
        ({"v": LAW}, {}, UnknownName, "no input 'v'"),
        ({"u": "2*phi"}, {}, UnknownName, "phi"),
        ({"u": LAW}, {"u": 1.0}, UsageError, "u is given a value and a series"),
        (3.0, {}, UsageError, "values by name"),
    ],
)
def test_nonsense_of_inputs_is_told(integrator, inputs, start, kind, told):
    with pytest.raises(kind, match=told):
        cosim.simulate_fmu(integrator, inputs=inputs, start_values=start)


def test_series_and_formula_of_one_input_are_refused(integrator, tmp_path, capsys):
    (tmp_path / "u.csv").write_text("time,u\n0,0\n1,1\n")
    line = ["simulate", str(integrator), "--input-file", str(tmp_path / "u.csv")]
    assert main([*line, "--input", "u=t"]) == 2
    assert "u has a formula and a column" in capsys.readouterr().err


JUMPS = cosim.InputSeries(("u",), [0, 1 / 3, 1 / 3, 0.7, 0.7, 1], [[0], [0], [2], [3], [-1], [-1]])


@pytest.fixture(scope="module", params=[2, 3])
def lag(request, tmp_path_factory):
    model = Model("lag", description="x' = u - x", source="a test", stop_time=1.0)
    x, u = model.state("x", "m", 0.5, "what follows"), model.input("u", "m", 0.0, "input")
    model.derivative(x, u - x)
    model.output("fed_through", "m", 2 * u, "what feels the input at once")
    path = tmp_path_factory.mktemp("fmu") / "lag.fmu"
    return request.param, cosim.export_fmu(model.freeze(), path, fmi=request.param)


def lagging(times):
    """Return x of x' = a + b s - x from y, piece by piece: (y - a + b) exp(-s) + a + b s - b."""
    found, start = np.empty(len(times)), 0.5
    for begin, end, a, last in ((0, 1 / 3, 0, 0), (1 / 3, 0.7, 2, 3), (0.7, 1, -1, -1)):
        b, here = (last - a) / (end - begin), (times > begin - 1e-9) & (times < end + 1e-9)
        past = np.append(times[here], end) - begin
        *found[here], start = (start - a + b) * np.exp(-past) + a + b * past - b
    return found


@pytest.mark.parametrize("interface", KINDS)
def test_input_that_jumps_has_one_value_on_each_side(lag, interface):
    run = cosim.simulate_fmu(
        lag[1], interface=interface, inputs=JUMPS, output_interval=0.1, relative_tolerance=1e-8
    )
    # measured below 1e-7
    np.testing.assert_allclose(run["x"], lagging(run.time), rtol=0, atol=1e-6)
    after = 2 * JUMPS.with_jumps_at(run.time).at(run.time)[0]
    np.testing.assert_allclose(run["fed_through"], after, rtol=0, atol=1e-12)


PULSE = "where(t > 0.33333, where(t < 0.33343, 1e4, 0), 0)"  # shorter than any step


@pytest.mark.parametrize("interface", KINDS)
@pytest.mark.parametrize("law", [PULSE, "where(t > 0, 1, 0)", lambda t: 2.0 * (t > 0.512)])
def test_jumps_of_a_law_are_met_within_a_step(integrator, interface, law):
    run = cosim.simulate_fmu(
        integrator, interface=interface, inputs={"u": law}, output_interval=0.1
    )
    exact = 2 * (1 - 0.512) if callable(law) else 1
    assert run.final["x"] == pytest.approx(exact, abs=1e-9)


def pulse(begin, length, height):
    time = [0, begin, begin, begin + length, begin + length, 4000]
    return cosim.InputSeries(("u",), time, [[0], [0], [height], [height], [0], [0]])


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("interface", KINDS)
@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        ({"u": "where(t > 1000.005, 1000, 0)"}, 1995),
        ({"u": "where(t > 999.995, 1000, 0)"}, 2005),
        ({"u": "where(t > 1000, 1000, 0)"}, 2000),
        ({"u": "where(t > 1002, 1000, 0)"}, 0),
        (pulse(1000 - 5e-7, 2000, 1e3), 2000.0005),
        (pulse(np.nextafter(1000, 0), 2000, 1e3), 2000),
        (pulse(np.nextafter(1000, 2000), 2000, 1e3), 2000),
        (pulse(1000.5, 5e-7, 2e6), 1),
        (pulse(1000, 5e-7, 2e6), 1),
        (pulse(1000 - 1e-8, 1e-8, 1e8), 1),
    ],
)
def test_jumps_near_an_output_time_and_near_each_other_happen_in_time(
    integrator, interface, inputs, expected, capfd
):
    options = {"output_interval": 1.0, "stop_time": 1002, "relative_tolerance": 1e-9}
    run = cosim.simulate_fmu(integrator, interface=interface, inputs=inputs, **options)
    assert run.final["x"] == pytest.approx(expected, rel=2e-6, abs=1e-9)  # measured 1e-6, of 1e-8 s
    np.testing.assert_array_equal(run.time, np.arange(1003))
    assert tuple(capfd.readouterr()) == ("", "")


def test_function_of_an_input_that_fails_where_fmi_3_asks_is_an_error(lag):
    if lag[0] == 2:
        pytest.skip("FMI 2.0 does not ask")

    def law(time):  # at a third of a step
        return 1 / 0 if 0.133 < time < 0.134 else 0.0

    with pytest.raises(FmuError, match="division by zero"):
        cosim.simulate_fmu(lag[1], interface="CoSimulation", inputs={"u": law}, output_interval=0.1)


def test_jump_at_the_start_or_the_end_is_none_within_the_run(lag):
    for times, levels in (([0, 0, 1], [5, 1, 1]), ([0, 1, 1], [1, 1, 9])):
        series = cosim.InputSeries(("u",), times, np.array(levels)[:, None])
        for interface in KINDS:
            run = cosim.simulate_fmu(
                lag[1], interface=interface, inputs=series, relative_tolerance=1e-8
            )
            assert run["fed_through"][0] == 2
            assert run["fed_through"][-1] == 2 * levels[-1]
            assert run.final["x"] == pytest.approx(1 - 0.5 / np.e, abs=1e-6)


@pytest.mark.slow_rows("2")
def test_file_with_a_time_twice_drives_both_backends_alike(lag, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rows = "\n".join(f"{t:.17g},{u}" for t, (u,) in zip(JUMPS.time, JUMPS.values, strict=True))
    (tmp_path / "u.csv").write_text(f"time,u\n{rows}\n")
    (tmp_path / "lag.py").write_text(
        "from casadi_models.dae import Model\n\ndef build():\n"
        "    model = Model('lag', stop_time=1.0)\n"
        "    x, u = model.state('x', 'm', 0.5, 'x'), model.input('u', 'm', 0.0, 'u')\n"
        "    model.derivative(x, u - x)\n    return model.freeze()\n"
    )
    for subject, more in (("lag.py:build", []), (str(lag[1]), ["--trust", "--outputs", "x"])):
        line = ["simulate", subject, *more, "--input-file", "u.csv", "-o", "run.csv"]
        assert main([*line, "--relative-tolerance", "1e-9"]) == 0, capsys.readouterr().err
        run = cosim.Trajectory.read_csv("run.csv")
        np.testing.assert_allclose(run["x"], lagging(run.time), rtol=0, atol=1e-6)


@pytest.mark.parametrize("interface", KINDS)
@pytest.mark.parametrize(("first", "last"), [(0.25, 1.0), (0.0, 0.5), (0.0, 1.0)])
def test_run_beyond_the_samples_is_reported(integrator, interface, first, last):
    part = cosim.InputSeries(("u",), [first, last], [[0.0], [1.0]])
    whole = cosim.InputSeries(("w",), [0.0, 1.0], [[0.0], [1.0]])
    for inputs in (part, {"u": part, "w": "sin(t)"}, {"u": part, "w": whole}):
        run = cosim.simulate_fmu(integrator, interface=interface, inputs=inputs)
        expected = f"u has samples from {first:g} to {last:g} s, and is constant before and after"
        note = run.stats.get("note", "")
        assert note.startswith(expected) == (last - first < 1)
        assert "w has" not in note


def test_formula_with_constants_drives_an_fmu(integrator):
    inputs = {"u": ("a*sin(w0*t)", {"a": 2.0, "w0": FREQUENCY})}
    run = cosim.simulate_fmu(integrator, interface="CoSimulation", inputs=inputs)
    assert np.abs(run["x"] - exact(run.time)).max() < STRAIGHT


@pytest.mark.parametrize("interface", KINDS)
def test_jump_soon_after_a_late_start_is_followed(integrator, interface):
    """The input goes from 0 to 1 a quarter of a microsecond after 12 days."""
    start, later = 2.0**20, 2.0**-22
    times = [start - 1, start + later, start + later, start + 1]
    series = cosim.InputSeries(("u",), times, [[0.0], [0.0], [1.0], [1.0]])
    span = {"start_time": start, "stop_time": start + 4 * later, "output_interval": 4 * later}
    run = cosim.simulate_fmu(integrator, interface=interface, inputs=series, **span)
    assert run.final["x"] == pytest.approx(3 * later, rel=1e-2)  # measured 1e-3; before: 4 later


@pytest.mark.parametrize("interface", KINDS)
@pytest.mark.parametrize(
    "law",
    [
        "exp(-((t - 0.53) / 1e-5)^2) * 1e5",
        lambda t: np.exp(-(((t - 0.53) / 1e-5) ** 2)) * 1e5,
    ],
    ids=["formula", "function"],
)
def test_no_run_of_an_fmu_passes_over_a_short_pulse(integrator, interface, law):
    run = cosim.simulate_fmu(integrator, interface=interface, inputs={"u": law})
    assert run.final["x"] == pytest.approx(np.sqrt(np.pi), rel=1e-3)  # before: 0
