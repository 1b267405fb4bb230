"""Hybrid models whose course is known in closed form, on each engine."""

import pytest
from helpers.hybrid_cases import check, engines_of
from helpers.hybrid_engines import ENGINES, judge
from helpers.mechanical_cases import MECHANICS
from helpers.switching_cases import SWITCHING

CASES = MECHANICS | SWITCHING


def rows():
    """Return all cases on all engines; quick are idas, and for every other case an engine in turn.

    What idas runs need not be compiled.
    """
    found = []
    for i, (name, case) in enumerate(CASES.items()):
        engines = engines_of(case, ENGINES)
        quick = {"idas"} if i % 2 else {"idas", engines[i // 2 % len(engines)]}
        for engine in engines:
            marks = [] if engine in quick else [pytest.mark.slow]
            found.append(pytest.param(name, engine, marks=marks))
    return found


@pytest.mark.parametrize(("name", "engine"), rows())
def test_a_hybrid_model_takes_the_course_of_its_closed_form(name, engine):
    wrong = judge(f"case/{name}/{engine}", lambda: check(CASES[name], name, engine))
    assert not wrong, wrong
