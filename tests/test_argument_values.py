"""Python calls with values that no type forbids: counts, flags, lines, ragged lists."""

from fractions import Fraction

import numpy as np
import pytest
from helpers.refusals import refusal, short
from helpers.small_models import decay

import cosim
from cosim.errors import CosimError, UnknownName, UsageError

DAE = decay()
RUN = cosim.simulate(DAE, stop_time=0.1, compiled=False)


NO_COUNT = [0, -1, True, 1.5, "2", None, float("nan"), 10**25, [1], 1j]


@pytest.mark.parametrize("wrong", NO_COUNT, ids=short)
@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda n: cosim.design("random", n, {"x": (0, 1)}), "runs"),
        (lambda n: cosim.fit(DAE, RUN, {"rate": (0.1, 1.0)}, starts=n), "starts"),
        (lambda n: cosim.simulate_many(DAE, {"x": [1.0]}, threads=n or 0), "threads"),
        (lambda n: cosim.simulate_many(DAE, {"x": [1.0]}, lanes=n or 0), "lanes"),
        (lambda n: cosim.open(DAE, copies=n or 0), "copies"),
        (lambda n: cosim.sweep(DAE, {"x": [1.0]}, workers=n or -1), "workers"),
        (lambda n: cosim.tradeoff(cosim.requested(DAE), repeats=n or -1), "repeats"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_whole_number_is_refused_before_anything_is_computed(call, name, wrong):
    assert name in refusal(UsageError, lambda: call(wrong))  # before: 10 GB, or numpy's error


@pytest.mark.parametrize("wrong", ["no", "", 0, 1, [], {}, 1.0], ids=short)
@pytest.mark.parametrize(
    ("call", "flag"),
    [
        (lambda **flag: cosim.compare(RUN, RUN, **flag), "resample"),
        (lambda **flag: cosim.sweep(DAE, {"x": [1.0]}, store="s", **flag), "resume"),
        (lambda **flag: cosim.sensitivity(DAE, **flag), "check"),
        (lambda **flag: cosim.extremes("crank_shaft", **flag), "long"),
        (lambda **flag: cosim.export_fmu(DAE, "x.fmu", **flag), "adjoint"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_flag_that_is_neither_true_nor_false_is_refused(call, flag, wrong):
    assert "give True or False" in refusal(UsageError, lambda: call(**{flag: wrong}))


def test_name_that_compare_shall_leave_out_must_exist():
    told = refusal(UnknownName, lambda: cosim.compare(RUN, RUN, without=["xx"]))
    assert "did you mean x?" in told
    assert "give a list" in refusal(UsageError, lambda: cosim.compare(RUN, RUN, without="xx"))


@pytest.mark.parametrize(
    "call",
    [
        lambda value: cosim.load(value),
        lambda value: cosim.simulate(DAE, solver=value),
        lambda value: cosim.simulate(DAE, stop_time=value),
        lambda value: cosim.simulate(DAE, stop_when=value),
        lambda value: cosim.linearize(DAE, at=value),
        lambda value: cosim.read_inputs(value),
        lambda value: cosim.export_fmu(DAE, "x.fmu", identifier=value),
        lambda value: cosim.animate(RUN, "x.html", view=value),
        lambda value: cosim.run_scene(value),
    ],
    ids=range(9),
)
@pytest.mark.parametrize("value", ["a\nb", "a\r\nb", "\0", np.ones((2, 2)), DAE, RUN], ids=short)
def test_value_of_several_lines_makes_a_message_of_one(call, value):
    refusal(CosimError, lambda: call(value))


RAGGED = [[1, 2], [3]]


@pytest.mark.parametrize(
    "call",
    [
        lambda: cosim.grid({"x": []}),
        lambda: cosim.grid({"x": RAGGED}),
        lambda: cosim.design("lhs", 2, {"x": ("a", "b")}),
        lambda: cosim.design("lhs", 2, {"x": (0, 1)}, seed=-1),
        lambda: cosim.reduce(DAE, ["x"], freeze=np.array([])),
        lambda: cosim.extremes(np.array([])),
        lambda: cosim.export_fmu(DAE, "x.fmu", platforms=np.array([])),
        lambda: cosim.fit(DAE, RUN, {"rate": RAGGED}),
        lambda: cosim.fit(DAE, RUN, {"rate": object()}),
        lambda: cosim.fit(DAE, RUN, {"rate": (0.1, 1.0)}, inputs={"force": 1.0}),
        lambda: cosim.simulate(DAE, inputs={"force": 10**400}),
        lambda: cosim.simulate(DAE, output_times=10**400),
        lambda: cosim.simulate_many(DAE, {"x": 10**400}),
        lambda: cosim.animate(RUN, "x.html", speed=5e-324),
        lambda: cosim.animate(RUN, "x.html", speed=float("inf")),
        lambda: cosim.write_ssp("x.ssp", {}, [[]]),
        lambda: cosim.write_ssp("x.ssp", {}, [(1.0, 2.0)]),
        lambda: cosim.couple({"a": DAE}, {}).simulate(outputs=[]),
        lambda: cosim.InputSeries(("force",), np.array(["a"]), np.ones((1, 1))),
        lambda: cosim.Scene("s", None),
        lambda: RUN[np.ones(3)],
        lambda: cosim.simulate_many(DAE, {"x": [1.0]}, stop_time=0.1).run(3),
    ],
)
def test_value_that_only_numpy_or_scipy_rejected_is_named(call):
    refusal(CosimError, call)


def test_fraction_is_a_number():
    half = Fraction(1, 2)
    assert "bound 0.5" in str(cosim.compare(RUN, RUN, bound=half))
    assert cosim.simulate(DAE, stop_time=half, compiled=False).time[-1] == 0.5
