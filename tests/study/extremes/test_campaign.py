"""Extreme cases: a sample in every test run, all of them in the slow one."""

import json
import random
import threading
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from helpers.samples import sampled

from casadi_models.extreme_cases import EXPLICIT, Case, Counterpart, catalogue
from cosim.cli.main import main
from cosim.errors import UnknownName
from cosim.integrate.run import run
from cosim.plotting import save
from cosim.present.study_figures import draw_map
from cosim.study.extremes import campaign, oracles
from cosim.study.extremes.campaign import (
    HANG,
    WRONG,
    explore,
    extremes,
    family_rows,
    select_cases,
)
from cosim.study.extremes.oracles import OUTCOMES, CaseFinding, assess, run_case

CASES = list(catalogue())
SLOWEST = "lean 89.99 deg"  # its references fail after seconds, and then others are tried
FAMILIES = list(dict.fromkeys(case.family for case in CASES if not case.long))


def find(family, name, model):
    (case,) = (c for c in CASES if (c.family, c.name, c.model) == (family, name, model))
    return case


def test_catalogue_has_at_least_300_different_cases():
    assert len({(case.family, case.model, case.name) for case in CASES}) == len(CASES) >= 300


@pytest.mark.quick_rows(
    "bar: equilibrium", "bicycle: near fall", "crank: mass", "crank: spin", "tolerances"
)
@pytest.mark.sample_of("test_no_case_of_a_family_has_a_wrong_outcome")
@pytest.mark.parametrize("family", FAMILIES)
def test_no_case_of_a_sample_has_a_wrong_outcome(family):
    members = [case for case in CASES if case.family == family and case.name != SLOWEST]
    for case in random.Random(family).sample(members, 1):
        verdict = assess(case)
        assert verdict.outcome not in WRONG, (case, verdict)


@pytest.mark.parametrize("family", sampled(FAMILIES, (), ("crank: spin", "bar: equilibrium")))
def test_no_case_of_a_family_has_a_wrong_outcome(family):
    members = [case for case in select_cases() if case.family == family]
    # one process, so that cases of the same values share their reference
    findings = list(explore(members, jobs=1))
    assert [f.row() for f in findings if f.outcome in WRONG] == []


@pytest.mark.slow
def test_cases_of_the_same_values_share_their_reference(monkeypatch):
    name = "b = 0.02 ft.lbf.s/rad"
    solved = [find("bar: damping", f"{name}, {each}", "bar_on_frame/reduced") for each in EXPLICIT]
    tolerances = []

    def counted(request):
        tolerances.append(request.relative_tolerance)
        return run(request)

    monkeypatch.setattr(oracles, "execute", counted)
    oracles._reference.cache_clear()
    endings = [assess(case) for case in solved]
    assert [ending.outcome for ending in endings] == ["accurate"] * len(solved)
    assert tolerances.count(1e-11) == len({case.references for case in solved}) < len(solved)


def test_crank_shaft_is_accurate_at_a_million_radians_per_second():
    verdict = assess(find("crank: spin", "omega = 1e6 rad/s", "crank_shaft/driven"))
    assert verdict.outcome == "accurate"
    assert verdict.error < 1e-8  # closed form; measured 1e-10


def test_singular_initial_state_is_rejected_with_a_remedy():
    model = "double_pendulum/euler_313_axial"
    verdict = assess(find("pendulum: 3-1-3 singularity", "theta1 = 0 rad, cvodes", model))
    assert verdict.outcome == "refused"
    assert "the quaternion formulation is regular there" in verdict.reason


@pytest.mark.parametrize("rtol", ["nan", "-1", "0", "1e-18", "1e-15", "1"])
def test_tolerance_below_double_precision_is_rejected(rtol):
    verdict = assess(find("tolerances", f"rtol {rtol}, cvodes", "double_pendulum/quaternion"))
    assert verdict.outcome == "refused"


@pytest.mark.parametrize("solver", ["rk4", "ode8"])
def test_explicit_fixed_step_on_the_stiff_bar_fails_with_a_message(solver):
    name = f"b = 2000 ft.lbf.s/rad, {solver}"
    verdict = assess(find("bar: damping", name, "bar_on_frame/reduced"))
    assert verdict.outcome == "failed"
    assert "not finite" in verdict.reason or "too long" in verdict.reason


def test_initial_state_without_algebraic_solution_is_rejected():
    verdict = assess(find("bicycle: near fall", "lean 90 deg", "bicycle/multipliers"))
    assert verdict.outcome == "refused"
    assert "no solution at the start" in verdict.reason


@pytest.mark.slow
def test_wrong_result_without_a_message_is_silent():
    right = find("bar: damping", "b = 0.02 ft.lbf.s/rad, cvodes", "bar_on_frame/reduced")
    wrong = replace(right, references=(Counterpart("bar_on_frame/reduced", "rk4"),), bound=1e-9)
    assert assess(right).outcome == "accurate"
    assert assess(wrong).outcome == "silent"


@pytest.mark.parametrize("name", ["phi", "fx_A", "T"])
def test_result_with_a_value_that_is_no_number_is_silent(name):
    """Where the other variables are right, too: `max` would return one of their errors."""
    case = find("crank: spin", "omega = 1e6 rad/s", "crank_shaft/driven")

    def runner(case):
        found = run_case(case)
        values = found.values.copy()
        values[-1, found.names.index(name)] = np.nan
        return replace(found, values=values)

    assert assess(case, runner).outcome == "silent"


def test_case_without_a_reference_is_unverified():
    right = find("bar: damping", "b = 0.02 ft.lbf.s/rad, cvodes", "bar_on_frame/reduced")
    assert assess(replace(right, references=())).outcome == "unverified"


def test_a_child_that_answers_while_it_is_killed_fails_no_other_case(monkeypatch):
    class Answering:
        """It answers a case named late when it has been killed, and nothing afterwards."""

        def __init__(self):
            self.killed = threading.Event()

        def ask(self, question):
            if self.killed.is_set():
                raise EOFError
            if json.loads(question)["name"] == "late":
                self.killed.wait(10)
            return json.dumps(["accurate", 0.0, "", 0.1])

        def kill(self):
            self.killed.set()

        def end(self):
            return -9

    monkeypatch.setattr(campaign._CaseWorker, "_start", lambda _: Answering())
    cases = [replace(CASES[0], name=name, long=False) for name in ("late", "next")]
    found = [finding.outcome for finding in explore(cases, timeout=0.05, jobs=1)]
    assert found == ["hang", "accurate"]


@pytest.mark.slow
def test_hang_and_crash_of_a_child_are_counted_and_the_next_case_runs(tmp_path):
    file = tmp_path / "model.py"
    file.write_text("import os, time\ndef hangs(): time.sleep(600)\ndef dies(): os._exit(3)\n")
    good = find("crank: spin", "omega = 1e0 rad/s", "crank_shaft/driven")
    cases = [Case("own", name, f"{file}:{name}") for name in ("hangs", "dies")]
    findings = list(explore([*cases, good], timeout=8, jobs=1))
    assert [f.outcome for f in findings] == ["hang", "crash", "accurate"]
    assert "code 3" in findings[1].reason


def test_function_and_command_have_the_same_time_limit(monkeypatch, capsys):
    limits = []

    def noted(_cases, *, timeout):
        limits.append(timeout)
        return iter(())

    monkeypatch.setattr("cosim.study.extremes.campaign.explore", noted)
    extremes("crank_shaft")
    assert main(["extremes", "crank_shaft", "-q"]) == 0
    assert main(["extremes", "crank_shaft", "-q", "--timeout", "7"]) == 0
    assert limits == [HANG, HANG, 7.0]
    with pytest.raises(SystemExit):
        main(["extremes", "--help"])
    assert f"time limit of one case in seconds (default: {HANG:g})" in capsys.readouterr().out


def test_unknown_model_is_rejected():
    with pytest.raises(UnknownName, match="did you mean bicycle"):
        select_cases(["bicicle"])


def test_command_writes_table_file_and_map_and_returns_0(tmp_path, monkeypatch, capsys):
    chosen = [c for c in CASES if c.family == "crank: mass"][:3]
    monkeypatch.setattr("cosim.study.extremes.campaign.select_cases", lambda *_, **__: chosen)
    table, figure = tmp_path / "cases.csv", tmp_path / "map.png"
    code = main(["extremes", "-q", "--output-file", str(table), "--figure", str(figure)])
    assert code == 0
    assert "crank: mass" in capsys.readouterr().out
    assert len(table.read_text().splitlines()) == 4
    assert matplotlib.image.imread(figure).ndim == 3


def test_command_returns_4_if_a_case_is_silent(monkeypatch, capsys):
    wrong = replace(find("crank: spin", "omega = 1e0 rad/s", "crank_shaft/driven"), bound=-1.0)
    monkeypatch.setattr("cosim.study.extremes.campaign.select_cases", lambda *_, **__: [wrong])
    assert main(["extremes", "-q"]) == 4


def test_summary_counts_every_outcome_and_names_the_worst():
    findings = [
        CaseFinding(Case("f", name, "m/x"), outcome, error, "", 0.0)
        for name, outcome, error in (
            ("a", "accurate", 1e-9),
            ("b", "accurate", 1e-7),
            ("c", "failed", None),
        )
    ]
    (row,) = family_rows(findings)
    assert (row["cases"], row["accurate"], row["failed"], row["silent"]) == (3, 2, 1, 0)
    assert (row["worst error"], row["at"]) == (1e-7, "m/x, b")


def test_map_labels_values_and_solvers():
    findings = [
        CaseFinding(Case("spin", f"omega = {v} rad/s, {s}", "m/x", solver=s), o, None, "", 0.0)
        for v, s, o in (
            ("1", "erk", "accurate"),
            ("1e-09", "erk", "failed"),
            ("1e-09", "idas", "silent"),
        )
    ]
    (axis,) = draw_map(findings).get_axes()
    assert [label.get_text() for label in axis.get_xticklabels()] == ["1e-9", "1"]
    assert axis.get_xlabel() == "omega [rad/s]"
    assert [label.get_text() for label in axis.get_yticklabels()] == ["x, erk", "x, idas"]
    places = [tuple(int(c[0]) for c in line.get_data()) for line in axis.lines]
    assert places == [(1, 0), (0, 0), (0, 1)]
    assert [text.get_text() for text in axis.texts] == ["f", "S"]  # readable without color


def test_map_names_the_parameter_of_a_row_if_there_are_several():
    findings = [
        CaseFinding(Case("masses", f"{name} x {factor}", model), "accurate", None, "", 0.0)
        for name, factor, model in (("mB", "1", "m/x"), ("mC", "1", "m/x"), ("mB", "10", "n/x"))
    ]
    (axis,) = draw_map(findings).get_axes()
    assert [label.get_text() for label in axis.get_yticklabels()] == ["m/x, mB", "m/x, mC", "n/x"]
    assert [label.get_text() for label in axis.get_xticklabels()] == ["1", "10"]
    assert axis.get_xlabel() == "factor"


def test_map_shows_each_outcome_in_its_own_color(tmp_path):
    findings = [CaseFinding(Case("f", o, "m/x"), o, None, "", 0.0) for o in OUTCOMES]
    (path,) = save([draw_map(findings)], str(tmp_path / "map.png"))
    pixels = matplotlib.image.imread(path)[..., :3].reshape(-1, 3)
    assert len(np.unique((pixels * 8).astype(int), axis=0)) > len(OUTCOMES)


@pytest.mark.quick_rows("bicycle: speed-speed = 0 m/s, idas-bicycle/multipliers")
@pytest.mark.parametrize(
    ("family", "name", "model"),
    [
        ("bicycle: speed", "speed = 0 m/s, idas", "bicycle/multipliers"),
        ("mass ratios", "m x 1e-09", "bar_on_frame/two_body"),
        ("mass ratios", "bar_mass x 1e-06", "disk_two_bars/multipliers"),
    ],
)
def test_idas_starts_from_consistent_rates_if_its_own_search_fails(family, name, model):
    assert assess(find(family, name, model)).outcome == "accurate"
