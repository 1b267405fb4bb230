"""Random models with friction, relays, samplers, resets and impacts against matrix exponentials."""

import numpy as np
import pytest
from helpers.hybrid_engines import ENGINES, run_on
from helpers.random_hybrids import FAMILIES, STOP, draw, model_of

QUICK = {"release": "cvodes", "impacts": "dop853"}
KINDS = ("dop853", "idas", "fmu3 cs fmpy", "fmu2 me fmpy")
FEW, MANY = range(4), range(4, 250)  # seeds
TIGHT = {  # of those whose errors would be 2e-5 to 5e-5
    "cvodes": {"relative_tolerance": 1e-10},
    "idas": {"relative_tolerance": 1e-10},
    "rk4": {"step_size": STOP / 800},
}
NEAR = 1e-6  # s; rows so near an event may lie on either side of it


def assert_courses(family, engine, seeds):
    """Assert that models of some seeds have the values and events of their exact courses."""
    model, names = model_of(family), FAMILIES[family].names
    own = {event.name for event in model.events}
    tolerance = 1e-4 if " me " in engine else 1e-5
    for seed in seeds:
        drawn = draw(family, seed)
        run = run_on(engine, model, start_values=drawn.numbers, **TIGHT.get(engine, {}))
        right = [(time, name) for time, name in drawn.course.events if name in own]
        found = [(event.time, event.name) for event in run.events if event.name in own]
        assert [name for _, name in found] == [name for _, name in right], seed
        late = [abs(t - exact) for (t, _), (exact, _) in zip(found, right, strict=True)]
        assert max(late, default=0) <= tolerance, seed
        times = np.array([time for time, _ in right])
        at = np.searchsorted(run.time, drawn.course.time - NEAR)
        apart = np.abs(np.subtract.outer(drawn.course.time, times))
        clear = np.ones(len(at), bool) if times.size == 0 else apart.min(axis=1) > NEAR
        for i, name in enumerate(names):
            error = np.abs(run[name][at] - drawn.course.values[:, i])[clear].max()
            assert error <= tolerance, f"{seed}: {name} by {error:.2g}"


def rows():
    """Return families and engines: a quick sample, one engine of each kind, and all others."""
    found = []
    for family in FAMILIES:
        for engine in ENGINES:
            mark = pytest.mark.slow if engine in KINDS else pytest.mark.nightly
            marks = [] if QUICK.get(family) == engine else [mark]
            found.append(pytest.param(family, engine, marks=marks))
    return found


# Measured: 2e-11 (dop853)
@pytest.mark.slow_rows("impacts-dop853")
@pytest.mark.parametrize(("family", "engine"), rows())
def test_random_models_take_their_exact_courses(family, engine):
    assert_courses(family, engine, FEW)


@pytest.mark.parametrize("engine", ["fmu2 cs c", "fmu3 cs c"])
def test_a_release_that_the_rounding_of_time_hides_from_a_step_is_found(engine):
    assert_courses("contacts", engine, [5051])


@pytest.mark.nightly
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("family", FAMILIES)
def test_a_thousand_random_models_take_their_exact_courses(family, engine):
    assert_courses(family, engine, MANY)
