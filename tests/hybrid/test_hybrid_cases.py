"""Hybrid models whose course is known in closed form, on each engine."""

import pytest
from helpers.hybrid_cases import check, engines_of
from helpers.hybrid_engines import ENGINES, judge
from helpers.mechanical_cases import MECHANICS
from helpers.switching_cases import SWITCHING

CASES = MECHANICS | SWITCHING


CHEAP = ("cvodes", "idas")  # whose models compile within 1 s


def rows():
    """Return all cases on all engines: every other case on a cheap one or one in turn is quick.

    Of the other rows, every sixth engine in turn is slow, and the rest nightly.
    """
    found = []
    for i, (name, case) in enumerate(CASES.items()):
        engines = engines_of(case, ENGINES)
        cheap = [engine for engine in engines if engine in CHEAP]
        of = engines if i % 8 == 1 else cheap
        quick = of[i // 8 % len(of)] if i % 2 else None
        for k, engine in enumerate(engines):
            rest = pytest.mark.slow if (i + k) % 6 == 0 else pytest.mark.nightly
            marks = [] if engine == quick else [rest]
            found.append(pytest.param(name, engine, marks=marks))
    return found


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("block starts and stops-ode8")
@pytest.mark.parametrize(("name", "engine"), rows())
def test_a_hybrid_model_takes_the_course_of_its_closed_form(name, engine):
    wrong = judge(f"case/{name}/{engine}", lambda: check(CASES[name], name, engine))
    assert not wrong, wrong
