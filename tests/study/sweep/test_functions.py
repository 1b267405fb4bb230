"""The name of a user's function in a store: another code or another value is another function."""

from functools import partial
from textwrap import dedent

import numpy as np
import pytest

import cosim
from cosim.errors import UsageError
from cosim.study.sweep.functions import function_name

MADE = dedent(
    """
    import numpy as np
    LEVEL, TABLE, FACTORS = {level}, np.linspace(0, {end}, 2001) ** 2, [1.0, {factor}]
    WEIGHT, ROW = {weight}, [1.0]
    ROWS = [ROW] * {rows}
    def weighted(run):
        return max(WEIGHT * x for x in run["x"])
    def helper(run):
        return [{power} * x for x in FACTORS]
    def outer(inner):
        def function(run, default={default}, *, word={word!r}):
            found = {{"a": np.{call}(run["x"]) + LEVEL, "b": TABLE[inner], "c": helper(run)}}
            return found | {{"d": len(ROWS), **{{name: weighted(run) for name in "ef"}}}}
        return function
    class Base:
        SHARE = {share}
        def doubled(self, n):
            return {twice} * n
    class Counting(Base):
        def __init__(self, start):
            self.start = start
        def __call__(self, run):
            return {{"n": self.start + {power}}}
        def method(self, run):
            return {{"m": self.doubled(self.start) + self.SHARE}}
        @classmethod
        def of_all(cls, run):
            return {{"c": cls.doubled(cls, cls.SHARE)}}
    """
)
USUAL = {
    **{"level": 0.5, "end": 1, "factor": 2.0, "power": 3, "default": 1, "word": "a"},
    **{"call": "max", "inner": 4, "start": 7, "weight": 5, "rows": 2, "share": 6, "twice": 2},
}


def made(kind, **changed):
    """Return a function of a script that is run anew."""
    facts = {**USUAL, **changed}
    script = {"__name__": "script"}
    exec(MADE.format(**facts), script)
    if kind == "function":
        return script["outer"](facts["inner"])
    if kind == "partial":
        return partial(script["outer"](1), default=facts["inner"])
    if kind == "classmethod":
        return script["Counting"].of_all
    counting = script["Counting"](facts["start"])
    if kind == "partial of a method":
        return partial(counting.method, 1)
    return counting.method if kind == "method" else counting


@pytest.mark.parametrize(
    ("kind", "changed"),
    [
        *(("function", {name: 9}) for name in ("level", "end", "factor", "power", "default")),
        *(("function", {name: 9}) for name in ("weight", "rows")),
        *((k, {n: 9}) for k in ("method", "object", "classmethod") for n in ("share", "twice")),
        *(("function", changed) for changed in ({"word": "b"}, {"call": "min"}, {"inner": 5})),
        *((kind, {"start": 8}) for kind in ("method", "object")),
        *(("partial of a method", {name: 9}) for name in ("start", "share", "twice")),
        *(("partial", {"inner": 9}), ("object", {"power": 4})),
    ],
    ids=str,
)
def test_another_code_or_value_is_another_function(kind, changed):
    name = function_name(made(kind))
    assert function_name(made(kind)) == name
    assert function_name(made(kind, **changed)) != name


def test_functions_of_packages_and_of_python_have_a_name():
    assert len({function_name(one) for one in (np.max, max, len, np.mean)}) == 4


@pytest.mark.parametrize("name", ["omega_final", "alpha", "time", "status", "run", "other"])
@pytest.mark.parametrize("stored", [False, True])
def test_a_number_with_a_name_that_the_results_have_is_rejected(name, stored, tmp_path):
    def own(run):
        return {name: run.final["omega"]}

    def other(run):
        return {"other": run.final["omega"]}

    keep = ["final", other, own]
    target = {"store": tmp_path / "store"} if stored else {}
    with pytest.raises(UsageError, match=f"a function of keep returns '{name}', which"):
        cosim.sweep("crank_shaft", {"alpha": [5.0]}, keep=keep, stop_time=1, workers=0, **target)


@pytest.mark.parametrize(
    ("kept", "name"), [("statistics", "omega_over_runs_mean"), ("trajectories", "omega_start")]
)
def test_a_number_does_not_replace_statistics_or_varied_values(kept, name, tmp_path):
    """The function's 7 replaced the values that were varied, and statistics replaced it."""

    def own(run):
        return {name: 7.0}

    for target in ({}, {"store": tmp_path / "store"}):
        with pytest.raises(UsageError, match=f"a function of keep returns '{name}', which"):
            cosim.sweep("crank_shaft", {"omega": [40, 50]}, keep=[kept, own], workers=0, **target)


def test_levels_that_are_close_are_different_numbers():
    """omega = 50 + alpha t crosses each level at its own time."""
    levels = (51.0, 51.0000001, 51.0000002, 51.5, 1e6)
    keep = [f"first(omega, {level!r})" for level in levels]
    found = cosim.sweep("crank_shaft", {"alpha": [5.0]}, keep=keep, stop_time=1, workers=0)
    expected = [(level - 50) / 5 for level in levels[:4]] + [np.nan]
    numbers = np.array([column[0] for column in found.numbers.values()])
    np.testing.assert_allclose(numbers, expected, rtol=0, atol=1e-9)
    names = [*found.numbers]
    assert (names[0], names[3], names[4]) == (
        "omega_first_51",
        "omega_first_51.5",
        "omega_first_1e+06",
    )


@pytest.mark.parametrize("level", ["e", "-", "1e", "1-2"])
def test_a_level_that_is_no_number_is_rejected(level):
    with pytest.raises(UsageError, match="is no number"):
        cosim.sweep("crank_shaft", {"alpha": [5.0]}, keep=[f"first(omega, {level})"], workers=0)
