"""The compiled master of FMUs: fmpy's numbers, the laws of motion, and fmpy's words."""

import signal
import sys
import threading

import numpy as np
import pytest
from helpers.ball import ball_fmu, free_fall
from helpers.fmi_cases import INTERFACES, VERSIONS
from helpers.foreign_part import foreign_part
from helpers.hostile import hostile, hostile_binary
from helpers.small_models import decay
from helpers.wrapped import wrapped

import cosim
from cosim.cli.main import main
from cosim.errors import FmuError, MissingTool, ParameterError, UnknownName, UsageError
from cosim.fmi.run import opened
from cosim.fmi.run.request import communication_points
from cosim.model.inputs import InputSeries


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("driven")
    return {fmi: cosim.export_fmu(decay(), folder / f"decay_{fmi}.fmu", fmi=fmi) for fmi in (2, 3)}


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ball")
    return {fmi: ball_fmu(folder, fmi) for fmi in (2, 3)}


@pytest.fixture(scope="module")
def write(tmp_path_factory):
    return hostile(hostile_binary(tmp_path_factory.mktemp("hostile")))


def both(path, **options):
    """Return a run through fmpy and one through the compiled master."""
    return [cosim.simulate_fmu(path, **options, master=master) for master in ("fmpy", "c")]


# -- numbers ------------------------------------------------------------------------------------


@pytest.mark.slow_rows("(0.0, 1.0, 0.1)-2")
@VERSIONS
@pytest.mark.parametrize("times", [(0.0, 1.0, 0.1), (0.3, 1.0, 0.13), (0.0, 0.5, 0.7)], ids=str)
def test_co_simulation_has_the_bits_of_fmpy(fmi, times, fmus):
    names = ("start_time", "stop_time", "output_interval")
    options = dict(zip(names, times, strict=True)) | {"start_values": {"x": 1.5}}
    through_fmpy, in_c = both(fmus[fmi], interface="CoSimulation", **options)
    np.testing.assert_array_equal(in_c.time, through_fmpy.time)
    np.testing.assert_array_equal(in_c.values, through_fmpy.values)
    assert in_c.columns == through_fmpy.columns
    assert in_c.stats["steps"] == len(in_c) - 1


@VERSIONS
def test_model_exchange_meets_the_closed_form(fmi, fmus):
    run = cosim.simulate_fmu(
        fmus[fmi], interface="ModelExchange", relative_tolerance=1e-9, master="c"
    )
    x = run["x"]
    exact = x[0] * np.exp(np.log(x[-1] / x[0]) * run.time / run.time[-1])
    np.testing.assert_allclose(x, exact, rtol=1e-8)
    through_fmpy = cosim.simulate_fmu(fmus[fmi], interface="ModelExchange", relative_tolerance=1e-9)
    np.testing.assert_array_equal(run.time, through_fmpy.time)
    np.testing.assert_allclose(run.values, through_fmpy.values, rtol=1e-6)


@VERSIONS
def test_events_of_time_and_states_are_met_exactly(fmi, balls):
    run = cosim.simulate_fmu(balls[fmi], master="c")
    expected = free_fall(run.time)
    np.testing.assert_array_equal(run["bounces"], expected["bounces"])
    np.testing.assert_array_equal(run["pushed"], expected["pushed"])
    for name in ("h", "v"):
        np.testing.assert_allclose(run[name], expected[name], rtol=0, atol=1e-8)
    assert run.stats["events"] == 2 * expected["bounces"][-1] + 1  # it leaves the ground again
    assert expected["bounces"][-1] >= 2


@VERSIONS
def test_an_event_at_an_output_time_is_recorded_after_it(fmi, balls):
    in_c, through_fmpy = (
        cosim.simulate_fmu(balls[fmi], stop_time=0.3, output_interval=0.05, master=master)
        for master in ("c", "fmpy")
    )
    assert in_c.time[5] == 0.25
    assert in_c["pushed"][4:6].tolist() == [0.0, 1.0]
    np.testing.assert_array_equal(in_c["pushed"], through_fmpy["pushed"])
    np.testing.assert_allclose(in_c.values, through_fmpy.values, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "span", [(0.0, 1.0, 0.1), (0.0, 1.0, 0.3), (0.1, 0.4, 0.1), (2.0, 2.0, 1.0)]
)
@pytest.mark.parametrize("any_step", [True, False])
def test_communication_points_are_those_of_a_loop(span, any_step):
    start, stop, interval = span
    found = communication_points(start, stop, interval, any_step=any_step)
    time, expected, n = start, [start], 0
    while time < stop and not np.isclose(time, stop, rtol=1e-9, atol=0):
        time = start + (n + 1) * interval
        if time > stop and not np.isclose(time, stop, rtol=1e-9, atol=0):
            if not any_step:
                break
            time = stop
        expected.append(time)
        n += 1
    assert found.tolist() == expected


@pytest.mark.parametrize("later", ["0.3", "0.1 * 3", "0.3 + 5e-16", "0.3 + 1e-15", "0.3 + 1e-9"])
def test_events_of_time_may_follow_each_other_at_once(tmp_path, later):
    """A file that announces 0.3 s, and then a time that is the same but for rounding."""
    body = (
        f"static const double times[] = {{0.3, {later}}}; static int n; fmi2Status s = CALL; "
        "info->nextEventTimeDefined = n < 2; if (n < 2) info->nextEventTime = times[n++]; return s;"
    )
    path = wrapped(tmp_path, fmi2NewDiscreteStates=body)
    run = cosim.simulate_fmu(path, interface="ModelExchange", master="c", stop_time=1.0)
    assert run.stats["events"] == 2
    assert run.time[-1] == 1
    np.testing.assert_allclose(run["x"], np.exp(-run.time / 2), rtol=1e-4)


# -- what goes wrong ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "interface"),
    [
        ("fmi2DoStep status 3", "CoSimulation"),
        ("fmi2DoStep status 2", "CoSimulation"),
        ("fmi2DoStep status -7", "CoSimulation"),
        ("fmi2GetReal status 3", "CoSimulation"),
        ("fmi2SetTime status 3", "ModelExchange"),
        ("fmi2EnterInitializationMode status 3", "ModelExchange"),
        ("fmi2Terminate status 3", "ModelExchange"),
    ],
)
def test_a_failed_call_is_told_in_the_words_of_fmpy(fault, interface, write):
    path, said = write(fault), []
    for master in ("fmpy", "c"):
        with pytest.raises(FmuError) as caught:
            cosim.simulate_fmu(path, interface=interface, master=master)
        said.append(str(caught.value))
    assert said[0] == said[1]


def test_derivatives_that_are_always_discarded_end_the_run(write):
    path = write("fmi2GetDerivatives status 2")
    with pytest.raises(FmuError, match=r"fmi2GetDerivatives failed with status 2 \(discard\)"):
        cosim.simulate_fmu(path, interface="ModelExchange", master="c")


@VERSIONS
def test_an_fmu_that_ends_the_simulation_ends_the_run(fmi, balls):
    landing = 0.25 + ((2 - 9.81 / 4) + np.sqrt((2 - 9.81 / 4) ** 2 + 2 * 9.81 * 0.6934375)) / 9.81
    for run in both(balls[fmi], start_values={"limit": 1.0}):
        assert run.complete
        assert run.time[-1] == pytest.approx(landing, abs=1e-7)
        assert (np.diff(run.time) > 0).all()
        assert run.final["h"] == pytest.approx(0, abs=1e-6)
        assert run.stats["stop"] == f"the FMU ends the run from {run.time[-1]:.12g} s on"


@INTERFACES
# if Ctrl-C falls between open() and its `with`, Python closes the file and warns
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_ctrl_c_ends_a_run(interface, fmus):
    before = signal.getsignal(signal.SIGINT)
    timer = threading.Timer(0.3, signal.raise_signal, [signal.SIGINT])
    options = {"stop_time": 1e4, "output_interval": 0.002, "interface": interface}
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        cosim.simulate_fmu(fmus[2], **options, master="c")
    assert signal.getsignal(signal.SIGINT) is before


def test_what_the_master_does_not_have_is_refused(fmus, monkeypatch):
    with pytest.raises(UnknownName, match="did you mean c"):
        cosim.simulate_fmu(fmus[2], master="C")
    series = InputSeries(("u",), np.array([0.0, 1.0]), np.array([[0.0], [1.0]]))
    with pytest.raises(UsageError, match="takes no series of inputs; use 'fmpy'"):
        cosim.simulate_fmu(fmus[2], inputs=series, master="c")
    monkeypatch.setattr(opened, "cached_library", _no_compiler)
    monkeypatch.setattr(opened, "_library", opened._library.__wrapped__)
    with pytest.raises(MissingTool, match="no compiler"):
        cosim.simulate_fmu(fmus[2], interface="CoSimulation", master="c")


def _no_compiler(*_):
    raise MissingTool("no compiler; install one")


# -- kept open ----------------------------------------------------------------------------------


def test_a_file_is_unpacked_once_and_runs_do_not_feel_each_other(fmus, monkeypatch, tmp_path):
    path = tmp_path / "decay.fmu"
    path.write_bytes(fmus[2].read_bytes())
    count = []
    original = opened.unpacked

    def counted(path, **options):
        count.append(path)
        return original(path, **options)

    monkeypatch.setattr(opened, "unpacked", counted)
    first = cosim.simulate_fmu(path, master="c")
    cosim.simulate_fmu(path, start_values={"x": 3.0}, master="c")
    again = cosim.simulate_fmu(path, master="c")
    assert len(count) == 1
    np.testing.assert_array_equal(first.values, again.values)


def test_a_file_that_has_changed_is_read_again(fmus, tmp_path):
    path = tmp_path / "x.fmu"
    path.write_bytes(fmus[2].read_bytes())
    assert cosim.simulate_fmu(path, master="c").model == "decay"
    path.unlink()
    cosim.export_fmu(cosim.load("crank_shaft"), path)
    assert cosim.simulate_fmu(path, master="c").model == "crank_shaft_driven"


def test_the_command_line_offers_it(fmus, tmp_path):
    table = tmp_path / "run.csv"
    options = ["--interface-type", "CoSimulation", "--trust", "-o", str(table)]
    assert main(["simulate", str(fmus[2]), "--master", "c", *options]) == 0
    in_c = table.read_bytes()
    assert main(["simulate", str(fmus[2]), *options]) == 0
    assert table.read_bytes() == in_c
    assert main(["simulate", "crank_shaft", "--master", "c"]) == 2


@INTERFACES
@pytest.mark.parametrize("master", ["c", "fmpy"])
def test_run_that_begins_at_a_time_stamp_ends_where_asked(interface, master, fmus):
    times = {"start_time": 1.7e9, "stop_time": 1.7e9 + 1, "output_interval": 0.01}
    run = cosim.simulate_fmu(fmus[2], interface=interface, master=master, **times)
    assert (len(run), run.time[0], run.time[-1]) == (101, 1.7e9, 1.7e9 + 1)
    exact = np.exp(-0.5 * (run.time - 1.7e9))
    np.testing.assert_allclose(run["x"], exact, rtol=1e-5)  # double precision tells 2e-7 s apart


@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_nominal_value_that_is_not_positive_counts_as_1(master, tmp_path):
    zero = "fmi2Status s = CALL; for (size_t i = 0; i < n; i++) x[i] = 0; return s;"
    path = wrapped(tmp_path, fmi2GetNominalsOfContinuousStates=zero)
    run = cosim.simulate_fmu(path, interface="ModelExchange", master=master)
    assert run.final["y"] == pytest.approx(2 * np.exp(-0.5), rel=1e-4)


@INTERFACES
@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_no_value_is_read_after_the_end(master, interface, tmp_path):
    lost = "fmi2Status s = CALL; for (size_t i = 0; limit && i < n; i++) value[i] = NAN; return s;"
    path = wrapped(tmp_path, fmi2Terminate="limit = 1; return CALL;", fmi2GetReal=lost)
    run = cosim.simulate_fmu(path, interface=interface, master=master)
    assert run.final["y"] == pytest.approx(2 * np.exp(-0.5), rel=1e-4)


@pytest.mark.skipif(sys.platform != "linux", reason="it compiles for linux64")
@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_steps_of_one_size_that_miss_the_stop_time_are_an_error(master, tmp_path):
    """The C master ended at 0.99 s without a word."""
    fixed = {"canHandleVariableCommunicationStepSize": "false"}
    path = foreign_part(tmp_path, "lag", step_size=0.03, **fixed)
    with pytest.raises(ParameterError, match=r"0\.03 s lead to 0\.99 s and not to 1 s; give stop"):
        cosim.simulate_fmu(path, master=master)
    assert cosim.simulate_fmu(path, master=master, output_interval=0.05).time[-1] == 1
    span = {"start_time": 1000, "stop_time": 1000.9, "output_interval": 7e-4}
    with pytest.raises(ParameterError, match=r"to 1000\.8995 s and not to 1000\.9 s; give stop"):
        cosim.simulate_fmu(path, master=master, **span)
