"""Input series: what a CSV file says, and what a torque over time does to a free bar."""

import numpy as np
import pytest
from helpers.fmu_files import set_attributes, with_description

import cosim
from cosim.codegen import compiler
from cosim.codegen.terms import pulse_times
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.model.driving import driven, followed, with_tables
from cosim.model.inputs import InputSeries, read_inputs
from cosim.study.sweep.subject import ModelSubject

INERTIA = 0.2 * 14.593902937206364 * 0.3048**2 / 12  # slender bar about its middle, kg.m2
# A pulse whose corners lie between the output times, and a ramp that does not end
SERIES = InputSeries(
    ("T2",), [0.0, 0.203, 0.2071, 0.411, 0.4133, 2.0], [[0.0], [0.0], [0.05], [0.04], [0.0], [0.1]]
)
FREE = {"theta": 0.2, "theta_dot": 0.0, "Omega": 0.0, "Omega_dot": 0.0, "b": 0.0}


@pytest.fixture(scope="module")
def bar():
    return cosim.load("bar_on_frame/reduced")


@pytest.fixture(scope="module")
def bicycle():
    return cosim.load("bicycle/independent")


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a CSV file."""

    def write(content):
        path = tmp_path / "torque.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def free_bar(times, series=SERIES):
    """Return angle and rate of a bar that only the torque moves: its integrals, exactly."""
    angle, rate, before = 0.2, 0.0, 0.0
    result = []
    corners = series.time
    for time in times:
        for end in (*corners[(corners > before) & (corners < time)], time):
            torque, last = (float(series.at(np.array([t]))[0, 0]) for t in (before, end))
            step, slope = end - before, 0.0
            if step > 0:
                slope = (last - torque) / step
            angle += rate * step + (torque * step**2 / 2 + slope * step**3 / 6) / INERTIA
            rate += (torque * step + slope * step**2 / 2) / INERTIA
            before = end
        result.append((angle, rate))
    return np.array(result).T


def run_of_file(path, interface, inputs=SERIES, *, stop=1.0, interval=0.01, tolerance=None):
    """Return the run of the free bar's FMU under a torque over time."""
    return cosim.simulate_fmu(
        path,
        interface=interface,
        stop_time=stop,
        output_interval=interval,
        inputs=inputs,
        start_values=FREE,
        relative_tolerance=tolerance,
    )


def test_values_are_linear_between_samples_and_constant_outside():
    series = InputSeries(("a", "b"), [1.0, 2.0, 4.0], [[0, 5], [2, 5], [-2, 5]])
    inside = series.at(np.array([0.0, 1.5, 3.0, 9.0]))
    assert inside.tolist() == [[0, 1, 0, -2], [5, 5, 5, 5]]


def test_series_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        SERIES.values[0, 0] = 1.0


def test_series_of_some_inputs_only():
    series = InputSeries(("a", "b"), [1.0, 2.0], [[0, 5], [2, 6]])
    assert series.only({"b"}).values.tolist() == [[5], [6]]
    assert series.only({"c"}) is None


@pytest.mark.slow_rows("erk", "rosenbrock")
@pytest.mark.parametrize("solver", ["cvodes", "cvodes_adams", "idas", "erk", "rosenbrock"])
def test_torque_over_time_moves_a_free_bar_as_its_integrals_say(bar, solver):
    rtol = 1e-10
    run = cosim.simulate(
        bar, stop_time=1, inputs=SERIES, start_values=FREE, solver=solver, relative_tolerance=rtol
    )
    angle, rate = free_bar(run.time)
    # measured 0.3 to 3 rtol, erk (which crosses the corners by trial) 82 and 139
    np.testing.assert_allclose(run["theta"], angle, rtol=0, atol=500 * rtol)
    np.testing.assert_allclose(run["theta_dot"], rate, rtol=0, atol=500 * rtol)


@pytest.mark.slow_rows("ode8")
@pytest.mark.parametrize("solver", ["rk4", "ode8"])
def test_fixed_steps_that_end_at_the_samples_are_exact(bar, solver):
    corners = InputSeries(("T2",), [0.0, 0.2, 0.21, 0.5], [[0.0], [0.0], [0.05], [-0.05]])
    run = cosim.simulate(bar, stop_time=1, inputs=corners, start_values=FREE, solver=solver)
    angle, rate = free_bar(run.time, corners)
    np.testing.assert_allclose(run["theta"], angle, rtol=0, atol=1e-14)  # measured 6e-17
    np.testing.assert_allclose(run["theta_dot"], rate, rtol=0, atol=1e-14)  # measured 1.1e-16


@pytest.mark.parametrize(
    ("fmi", "interface", "bound"),
    [
        pytest.param(2, "ModelExchange", 2e-8, id="FMI 2 ME"),  # measured 6e-9 at rtol 1e-10
        pytest.param(3, "ModelExchange", 2e-8, id="FMI 3 ME"),  # the same
        pytest.param(2, "CoSimulation", 1e-13, id="FMI 2 CS"),  # measured 4e-16: slopes are given
        pytest.param(3, "CoSimulation", 1e-13, id="FMI 3 CS"),  # measured 4e-16: it asks
    ],
)
def test_fmu_under_a_torque_over_time_does_the_same(bar, tmp_path, fmi, interface, bound):
    path = cosim.export_fmu(bar, tmp_path / "bar.fmu", fmi=fmi)
    run = run_of_file(path, interface, tolerance=1e-10)
    angle, rate = free_bar(run.time)
    np.testing.assert_allclose(run["theta"], angle, rtol=0, atol=bound)
    np.testing.assert_allclose(run["theta_dot"], rate, rtol=0, atol=bound)


@pytest.mark.parametrize("interface", ["ModelExchange", "CoSimulation"])
def test_short_pulse_on_a_body_at_rest_is_not_stepped_over(bar, tmp_path, interface):
    path = cosim.export_fmu(bar, tmp_path / "bar.fmu")
    times = [0.0, 23.0, 23.001, 23.011, 23.012]  # fmpy's CVODE takes steps of up to 0.8 s
    pulse = InputSeries(("T2",), times, [[0.0], [0.0], [0.05], [0.05], [0.0]])
    run = run_of_file(path, interface, pulse, stop=40, interval=4, tolerance=1e-8)
    rate = free_bar(run.time, pulse)[1]
    assert rate[-1] == pytest.approx(0.0243, abs=1e-4)
    # measured 3.7e-8 ME at rtol 1e-8, 7e-18 CS
    np.testing.assert_allclose(run["theta_dot"], rate, rtol=0, atol=2e-7)


def test_inputs_held_within_steps_leave_an_error_of_second_order(bar, tmp_path):
    """In a file that neither takes slopes nor asks within its steps."""
    own = cosim.export_fmu(bar, tmp_path / "own.fmu", fmi=3)
    edit = set_attributes("CoSimulation", recommendedIntermediateInputSmoothness=None)
    path = with_description(own, tmp_path / "bar.fmu", edit)
    smooth = InputSeries(("T2",), [0.0, 1.0], [[0.0], [0.1]])
    errors = []
    for interval in (0.02, 0.01):
        run = run_of_file(path, "CoSimulation", smooth, interval=interval)
        errors.append(np.abs(run["theta"] - free_bar(run.time, smooth)[0]).max())
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.01)


def test_outputs_that_feel_an_input_at_once_follow_it_on_both_backends(bar, tmp_path):
    path = cosim.export_fmu(bar, tmp_path / "bar.fmu")
    run = cosim.simulate(bar, stop_time=1, inputs=SERIES, start_values=FREE)
    torque = SERIES.at(run.time)[0]
    np.testing.assert_allclose(run["t2_G_F"], torque, rtol=0, atol=1e-15)
    for interface in ("ModelExchange", "CoSimulation"):
        again = run_of_file(path, interface)
        np.testing.assert_allclose(again["t2_G_F"], torque, rtol=0, atol=1e-12)


def test_values_end_the_series_of_the_request_that_they_are_given_to(bar):
    # A constant torque turns a free bar by T2 t^2 / (2 I); many runs begin a request with others
    request = cosim.requested(bar, inputs=SERIES, start_values=FREE, stop_time=1.0)
    torques = np.array([0.0, 0.03])
    exact = 0.2 + torques / (2 * INERTIA)
    keywords = {"outputs": ["theta"], "relative_tolerance": 1e-10}
    one = [cosim.simulate(request, start_values={"T2": t}, **keywords) for t in torques]
    np.testing.assert_allclose([run.final["theta"] for run in one], exact, rtol=0, atol=1e-8)
    many = cosim.simulate_many(request, {"T2": torques}, **keywords)
    np.testing.assert_allclose(many["theta"][:, -1], exact, rtol=0, atol=1e-8)
    swept = cosim.sweep(ModelSubject(request), {"T2": torques}, **keywords)
    np.testing.assert_allclose(swept["theta_final"], exact, rtol=0, atol=1e-8)


@pytest.mark.parametrize("inputs", [SERIES, {"T2": 0.03}, {"T2": "0.1*t"}])
def test_value_of_an_input_that_the_same_call_drives_is_rejected(bar, inputs):
    for simulate, torque in (cosim.simulate, 1.0), (cosim.simulate_many, [1.0, 2.0]):
        with pytest.raises(UsageError, match=r"^bar_on_frame/reduced: T2 is given twice; "):
            simulate(bar, inputs=inputs, start_values={"T2": torque}, stop_time=0.1)


def test_fmu_without_such_an_input_says_so(bar, tmp_path):
    path = cosim.export_fmu(bar, tmp_path / "bar.fmu")
    series = InputSeries(("T3",), [0, 1], [[0], [1]])
    with pytest.raises(UnknownName, match=r"no input 'T3'; .*T2"):
        cosim.simulate_fmu(path, inputs=series)


def test_csv_with_byte_order_mark_crlf_and_spaces_is_read(bicycle, write):
    text = "\ufefftime, steer_torque ,roll_torque\r\n0,0,1\r\n 0.5 ,1e-1,.5\r\n1,-2.5,+0\r\n\r\n"
    series = read_inputs(write(text), bicycle)
    assert series.names == ("steer_torque", "roll_torque")
    assert series.time.tolist() == [0, 0.5, 1]
    assert series.values.tolist() == [[0, 1], [0.1, 0.5], [-2.5, 0]]


@pytest.mark.parametrize(
    "text",
    [
        "time;steer_torque;roll_torque\n0;0;1\n0.5;2;3\n",
        "# of a test\ntime\troll_torque\tsteer_torque\n\n0\t1\t0\n0.5\t3\t2\n",
        "time [ms],steer_torque [N.cm],roll_torque\n0,0,1\n500,200,3\n",
        "steer_torque,time,roll_torque\nkN.m,ms,N.m\n0,0,1\n0.002,500,3\n",
    ],
    ids=["semicolons", "tabs", "units in brackets", "units in a line"],
)
def test_csv_of_another_tool_is_read(bicycle, write, text):
    series = read_inputs(write(text), bicycle)
    assert series.time.tolist() == [0, 0.5]
    values = {n: series.values[:, i].tolist() for i, n in enumerate(series.names)}
    assert values == {"steer_torque": [0, 2], "roll_torque": [1, 3]}


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        pytest.param("time,steer_torque\n0,1\n1,\n", ParameterError,
                     r"line 3, column 'steer_torque': nan is missing, .* in every cell", id="gap"),
        pytest.param("time,steer_torque\n0,1\n1\n", ParameterError,
                     r"line 3: 1 cells under 2 names", id="short line"),
        pytest.param("time,steer_torque\n0,nan\n1,2\n", ParameterError,
                     r"line 2, column 'steer_torque': nan is missing, not finite", id="nan"),
        pytest.param("time,steer_torque\n0,1\ninf,2\n", ParameterError,
                     r"line 3: the time is infinite", id="infinite time"),
        pytest.param("time,steer_torque\n0,1\n1,2 N.m\n", ParameterError,
                     r"line 3, column 'steer_torque': '2 N.m' is not a number", id="unit"),
        pytest.param("time,steer_torque\n0,1_0\n1,2\n", ParameterError,
                     r"'1_0' is not a number", id="digit grouping"),
        pytest.param("time,steer_torque\n0,0,5\n1,1,5\n", ParameterError,
                     r"line 2: 3 cells .* decimal point", id="decimal comma"),
        pytest.param('time,steer_torque\n0.5,"0,5"\n1,"1,5"\n', ParameterError,
                     r"line 2, column 'steer_torque': '0,5' .* decimal point", id="both marks"),
        pytest.param("time,steer_torqe\n0,1\n1,2\n", UnknownName,
                     r"input 'steer_torqe'; did you mean steer_torque", id="unknown"),
        pytest.param("time,phi\n0,1\n1,2\n", UnknownName,
                     r"no input 'phi'", id="state as column"),
        pytest.param("time,steer_torque,steer_torque\n0,1,1\n1,2,2\n", UsageError,
                     r"'steer_torque' occurs twice", id="twice"),
        pytest.param("steer_torque,roll_torque\n0,1\n1,2\n", UnknownName,
                     r"no column 'time'", id="no time"),
        pytest.param("time,steer_torque [kg]\n0,1\n1,2\n", UsageError,
                     r"is in 'kg', which does not convert to 'N.m'", id="other unit"),
        pytest.param("0,1\n1,2\n", UsageError, r"line 1: no header", id="no header"),
        pytest.param("time\n0\n1\n", UsageError, r"line 1: no header", id="time only"),
        pytest.param("", UsageError, r"is empty; give a CSV file", id="empty file"),
        pytest.param("time,steer_torque\n0,1\n", UsageError,
                     r"one sample; give two or more", id="one sample"),
        pytest.param("time,steer_torque\n", UsageError, r"no sample below", id="no sample"),
        pytest.param("time,steer_torque\n0,1\n2,1\n1,1\n", ParameterError,
                     r"line 4: time decreases; sort the lines", id="time goes back"),
        pytest.param("time,steer_torque\n0,1\n2,1\n2,3\n2,4\n", ParameterError,
                     r"line 5, column 'time': 2 s .* for the third time; sort", id="time thrice"),
        pytest.param(b"time,steer_torque\n0,\xff\n", UsageError, r"not a UTF-8 text", id="bytes"),
    ],
)  # fmt: skip
def test_bad_csv_is_refused_with_file_line_and_column(bicycle, write, text, error, message):
    path = write(text)
    with pytest.raises(error, match=message) as caught:
        read_inputs(path, bicycle)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        'time,steer_torque\n0,"0,5"\n1,"1,5"\n',
        "time;steer_torque\n0;0,5\n1;1,5\n",
    ],
)
def test_decimal_commas_are_read_where_no_number_has_a_point(bicycle, write, text):
    series = read_inputs(write(text), bicycle)
    np.testing.assert_array_equal(series.values[:, 0], [0.5, 1.5])


def test_missing_csv_is_named(bicycle, tmp_path):
    with pytest.raises(UsageError, match=r"cannot read .*none\.csv: No such file"):
        read_inputs(tmp_path / "none.csv", bicycle)


@pytest.mark.parametrize(
    ("names", "time", "values", "message"),
    [
        pytest.param(("a",), [0.0], [[1.0]], "m > 1", id="one sample"),
        pytest.param(("a",), [0.0, 1.0], [1.0, 2.0], "shapes", id="values in one dimension"),
        pytest.param(("a", "a"), [0, 1], [[1, 1], [1, 1]], "each of them once", id="twice"),
        pytest.param((), [0, 1], np.empty((2, 0)), "name every input", id="no input"),
        pytest.param(("a",), [0, 1], [[1], [np.nan]], "not finite", id="nan"),
        pytest.param(("a",), [0, 2, 1], [[1], [1], [2]], "1 s comes after 2 s", id="time falls"),
        pytest.param(("a",), [1, 1, 1], [[1], [1], [2]], "for the third time", id="time thrice"),
    ],
)
def test_series_refuses_nonsense(names, time, values, message):
    with pytest.raises(ParameterError, match=message):
        InputSeries(names, time, values)


def test_time_that_stands_twice_is_a_jump(write):
    series = read_inputs(write("time,a,b\n0,0,4\n1,1,4\n1,5,4\n2,7,4\n"))
    assert series.jumps.tolist() == [1]
    assert series.at([0.5, 1.0, 1.5]).tolist() == [[0.5, 5, 6], [4, 4, 4]]
    assert series.before([0.5, 1.0, 1.5]).tolist() == [[0.5, 1, 6], [4, 4, 4]]
    one, two = series.around(0.9), series.around(1.0)
    assert one.at([3.0])[0] == [1]  # beyond its end, it rests
    assert two.at([0.0])[0] == [5]
    assert not one.jumps.size + two.jumps.size


def test_series_are_joined_with_the_jumps_of_each():
    dae = cosim.load("bicycle")
    step = InputSeries(("a",), [0, 1, 1, 2], [[0], [0], [1], [1]])
    ramp = InputSeries(("b",), [0, 4], [[0], [4]])
    given = {"steer_torque": step, "roll_torque": ramp}
    joined = driven(dae, given, lambda: np.array([0.0, 2.0])).series
    assert joined.time.tolist() == [0, 1, 1, 2, 4]
    assert joined.at([1.0, 3.0]).tolist() == [[1, 1], [1, 3]]
    assert joined.before([1.0]).tolist() == [[0], [1]]


def test_jump_that_misses_an_output_time_by_rounding_is_moved_there():
    grid = np.linspace(0, 1, 11)  # 0.30000000000000004
    series = InputSeries(("a",), [0, 0.3, 0.3, 0.45, 0.45], [[0], [0], [1], [1], [2]])
    moved = series.with_jumps_at(grid)
    assert moved.jumps.tolist() == [grid[3], 0.45]
    assert grid[3] != 0.3


def test_jumps_long_after_time_zero_stay_where_they_are():
    grid = 1e9 + np.arange(4) / 1024
    time = 1e9 + np.array([0, 0.5, 0.5, 1]) / 1024
    series = InputSeries(("a",), time, [[0], [0], [1], [1]])
    assert series.with_jumps_at(grid).time.tolist() == time.tolist()


@pytest.mark.slow_rows("0.25-1.0")
@pytest.mark.parametrize(("first", "last"), [(0.25, 1.0), (0.0, 0.5), (0.0, 1.0)])
def test_run_beyond_the_samples_is_reported(bicycle, first, last):
    part = InputSeries(("steer_torque",), [first, last], [[0.0], [1.0]])
    whole = InputSeries(("roll_torque",), [0.0, 1.0], [[0.0], [1.0]])
    for inputs in (part, {"steer_torque": part, "roll_torque": whole}):
        note = cosim.simulate(bicycle, inputs=inputs, stop_time=1.0).stats.get("note", "")
        expected = f"steer_torque has samples from {first:g} to {last:g} s, and is constant"
        assert note.startswith(expected) == (last - first < 1)
        assert "roll_torque" not in note


@pytest.mark.slow
def test_another_constant_of_a_formula_compiles_nothing(bicycle, monkeypatch):
    def steered(gain, **options):
        inputs = {"steer_torque": ("gain*phi_dot + offset", {"gain": gain, "offset": 0.5})}
        return cosim.simulate(bicycle, inputs=inputs, stop_time=0.5, **options)

    first = steered(2.0, compiled=True)
    monkeypatch.setattr(compiler, "compile_library", lambda *_, **__: pytest.fail("compiled"))
    second = steered(3.0, compiled=True)
    assert second.numbers["gain"] == 3.0
    assert abs(second.final["phi"] - first.final["phi"]) > 1e-4
    written = {"steer_torque": "3.0*phi_dot + 0.5"}
    plain = cosim.simulate(bicycle, inputs=written, stop_time=0.5, compiled=False)
    np.testing.assert_allclose(second["phi"], plain["phi"], rtol=0, atol=1e-9)  # measured 1e-16


@pytest.mark.parametrize(
    ("inputs", "error", "text"),
    [
        (
            {"steer_torque": ("k*phi", {"k": 1.0, "phi": 2.0})},
            UsageError,
            "'phi' cannot name a constant",
        ),
        ({"steer_torque": ("k*phi", {"k 1": 1.0})}, UsageError, "'k 1' cannot name a constant"),
        ({"steer_torque": ("k*phi", {"other": 1.0})}, UnknownName, "no name 'k'"),
        ({"steer_torque": ("k*phi", {"k": "much"})}, ParameterError, "k .* is not a real number"),
        ({"steer_torque": ("k", {"k": 1}), "roll_torque": ("k", {"k": 2})}, UsageError, "two"),
    ],
)
def test_wrong_constants_of_a_formula_are_rejected(bicycle, inputs, error, text):
    with pytest.raises(error, match=text):
        cosim.simulate(bicycle, inputs=inputs, stop_time=0.1)


@pytest.mark.parametrize("gap", [2e-16, 1e-9, 1e-3])
def test_close_samples_cost_no_steps_elsewhere(gap, bicycle):
    """A pair of samples that are close is passed like a jump, which it nearly is."""
    values = [[0.0], [0.1], [0.2], [0.0]]
    close = InputSeries(("steer_torque",), [0.0, 1.0, 1.0 + gap, 2.0], values)
    jump = InputSeries(("steer_torque",), [0.0, 1.0, 1.0, 2.0], values)
    run, other = (
        cosim.simulate(bicycle, solver="cvodes", stop_time=2, inputs=inputs)
        for inputs in (close, jump)
    )
    assert run.stats["steps"] < 1.2 * other.stats["steps"]
    assert run.final["phi"] == pytest.approx(other.final["phi"], rel=1e-4 + 50 * gap)


def test_two_times_that_differ_by_rounding_are_a_jump():
    series = InputSeries(("u",), [0.0, 1.0, 1.0 + 2e-16, 2.0], [[0], [1], [2], [3]])
    assert series.jumps.tolist() == [1.0]
    assert len(series.around(1.5).time) == 2


def test_three_times_that_differ_by_rounding_are_a_jump_and_a_sample():
    time = [0.0, 1.0, 1.0 + 2**-52, 1.0 + 2**-51, 2.0]
    series = InputSeries(("u",), time, [[0], [1], [2], [3], [4]])
    assert series.time.tolist() == [0.0, 1.0, 1.0, 1.0 + 2**-51, 2.0]
    assert series.held().at([2.0]).tolist() == [[4.0]]


def test_joined_series_still_say_which_samples_end_early(bicycle):
    spans = {"steer_torque": (0.0, 1.0), "roll_torque": (0.0, 2.0)}
    series = InputSeries(tuple(spans), [0, 1, 2], [[0, 0], [1, 1], [1, 2]], spans=spans)
    joined = driven(bicycle, dict.fromkeys(spans, series), lambda: np.array([0.0, 2.0])).series
    assert joined.gaps(0.0, 2.0) == series.gaps(0.0, 2.0)
    assert "steer_torque has samples from 0 to 1 s" in joined.gaps(0.0, 2.0)


@pytest.mark.parametrize("torque", [[3.0], lambda t: 3.0 if t < 1 else 0.0])
def test_run_of_no_length_takes_samples_and_functions(bicycle, torque):
    series = driven(bicycle, {"steer_torque": torque}, lambda: np.array([0.0])).series
    assert series.at([0.0]).tolist() == [[3.0]]
    run = cosim.simulate(bicycle, stop_time=0, inputs={"steer_torque": torque}, compiled=False)
    assert run.time.tolist() == [0.0]


@pytest.mark.parametrize("header", ["Time", "TIME", "t", "time"])
def test_column_of_the_times_may_have_another_spelling(tmp_path, header):
    path = tmp_path / "u.csv"
    path.write_text(f"{header},u\n0,0\n5,50\n")
    assert read_inputs(path).at(np.array([2.0])).tolist() == [[20.0]]


def test_table_as_equations_moves_the_model_as_its_samples_do(bar):
    times, torques = [0.1, 0.2, 0.3, 0.3, 0.4], [0.0, 1.0, 0.5, -1.0, 0.25]
    series = InputSeries(("T2",), times, np.array(torques)[:, None])
    dae = cosim.load("bar_on_frame")
    runs = [
        cosim.simulate(dae, stop_time=0.6, inputs=series, relative_tolerance=1e-10),
        cosim.simulate(with_tables(dae, series), stop_time=0.6, relative_tolerance=1e-10),
    ]
    for name in ("theta", "theta_dot"):  # measured 1.5e-9 of 5 rad/s
        np.testing.assert_allclose(runs[0][name], runs[1][name], rtol=0, atol=1e-8)


def test_held_series_keeps_a_sample_until_the_next_one_also_at_jumps():
    time = [0.0, 0.0, 1.0, 2.0, 2.0, 3.0, 4.0]
    values = [[9.0], [1.0], [1.0], [5.0], [2.0], [3.0], [3.0]]
    held = InputSeries(("u",), time, values).held()
    at = np.array([-1.0, 0.0, 0.5, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 9.0])
    assert held.at(at).tolist() == [[9.0, 1.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0]]
    assert held.before(np.array([2.0, 3.0])).tolist() == [[1.0, 2.0]]  # 5 lasts for no time
    assert held.jumps.tolist() == [0.0, 2.0, 3.0]


@pytest.mark.parametrize("start", [0.0, -3.0, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("steps", [7, 16, 32, 59])  # at times that are rounded, or not
def test_formula_for_an_fmu_has_both_sides_of_each_of_its_jumps(steps, start):
    """Just before k / 7, seven times the time is rounded to k."""
    times, text = start + np.linspace(0, 1, 11), f"floor({steps}*(t - ({start})))"
    series = followed("fmu", {"u": text}, times, {"u": ("1", {})}, pulse_times)
    k = np.arange(steps + 1)
    np.testing.assert_allclose(series.jumps, start + k / steps, atol=0, rtol=1e-15)
    np.testing.assert_array_equal(series.at(series.jumps)[0], k)
    np.testing.assert_array_equal(series.before(series.jumps)[0], k - 1)
    for i, pair in enumerate(zip(series.jumps, series.jumps[1:], strict=False)):
        assert series.around(pair[0]).at(np.array(pair))[0].tolist() == [i, i]
