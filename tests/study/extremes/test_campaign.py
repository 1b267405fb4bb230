"""The limit cases: a sample of them in every run, all of them in the slow one; the judge itself."""

import random
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest

from cosim.cli.main import main
from cosim.errors import UnknownName
from cosim.integrate.simulate import simulate
from cosim.present.extremes_map import draw_map
from cosim.present.picture_files import save
from cosim.study.extremes import oracles
from cosim.study.extremes.campaign import (
    HANG,
    WRONG,
    CaseFinding,
    explore,
    extremes,
    family_rows,
    select_cases,
)
from cosim.study.extremes.cases import EXPLICIT, Case, Counterpart, catalogue
from cosim.study.extremes.oracles import OUTCOMES, CaseEnding, judge

CASES = list(catalogue())
SLOWEST = "lean 89.99 deg"  # its references fail after seconds, and then others are tried
FAMILIES = list(dict.fromkeys(case.family for case in CASES if not case.long))


def find(family, name, model):
    (case,) = (c for c in CASES if (c.family, c.name, c.model) == (family, name, model))
    return case


def test_catalogue_has_at_least_300_cases_each_of_them_once():
    assert len({(case.family, case.model, case.name) for case in CASES}) == len(CASES) >= 300


@pytest.mark.sample_of("test_every_case_of_a_family_ends_as_it_may")
@pytest.mark.parametrize("family", FAMILIES)
def test_sample_of_a_family_ends_as_it_may(family):
    members = [case for case in CASES if case.family == family and case.name != SLOWEST]
    for case in random.Random(family).sample(members, 3):
        verdict = judge(case)
        assert verdict.outcome not in WRONG, (case, verdict)


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_every_case_of_a_family_ends_as_it_may(family):
    members = [case for case in select_cases() if case.family == family]
    # one process, so that cases of the same values share their reference
    findings = list(explore(members, jobs=1))
    assert [f.row() for f in findings if f.verdict.outcome in WRONG] == []


def test_cases_of_the_same_values_share_their_reference(monkeypatch):
    name = "b = 0.02 ft.lbf.s/rad"
    alike = [find("bar: damping", f"{name}, {each}", "bar_on_frame/reduced") for each in EXPLICIT]
    tolerances = []

    def counted(dae, **options):
        tolerances.append(options["relative_tolerance"])
        return simulate(dae, **options)

    monkeypatch.setattr(oracles, "simulate", counted)
    oracles._reference.cache_clear()
    endings = [judge(case) for case in alike]
    assert [ending.outcome for ending in endings] == ["accurate"] * len(alike)
    assert tolerances.count(1e-11) == len({case.references for case in alike}) < len(alike)


def test_crank_shaft_is_accurate_at_a_million_radians_per_second():
    verdict = judge(find("crank: spin", "omega = 1e6 rad/s", "crank_shaft/driven"))
    assert verdict.outcome == "accurate"
    assert verdict.error < 1e-8  # closed form; measured 1e-10


def test_singular_start_is_refused_with_the_way_out():
    model = "double_pendulum/euler_313_axial"
    verdict = judge(find("pendulum: 3-1-3 singularity", "theta1 = 0 rad, cvodes", model))
    assert verdict.outcome == "refused"
    assert "the quaternion formulation is regular there" in verdict.reason


@pytest.mark.parametrize("rtol", ["nan", "-1", "0", "1e-18", "1e-15", "1"])
def test_tolerance_that_double_precision_does_not_carry_is_refused(rtol):
    verdict = judge(find("tolerances", f"rtol {rtol}, cvodes", "double_pendulum/quaternion"))
    assert verdict.outcome == "refused"


@pytest.mark.parametrize("solver", ["rk4", "ode8"])
def test_explicit_fixed_step_on_the_stiff_bar_fails_and_says_so(solver):
    name = f"b = 2000 ft.lbf.s/rad, {solver}"
    verdict = judge(find("bar: damping", name, "bar_on_frame/reduced"))
    assert verdict.outcome == "failed"
    assert "not finite" in verdict.reason or "too long" in verdict.reason


def test_pendulum_on_a_start_without_solution_of_its_algebraic_equations_is_refused():
    verdict = judge(find("bicycle: near fall", "lean 90 deg", "bicycle/multipliers"))
    assert verdict.outcome == "refused"
    assert "no solution at the start" in verdict.reason


def test_wrong_result_that_says_nothing_is_silent():
    right = find("bar: damping", "b = 0.02 ft.lbf.s/rad, cvodes", "bar_on_frame/reduced")
    wrong = replace(right, references=(Counterpart("bar_on_frame/reduced", "rk4"),), bound=1e-9)
    assert judge(right).outcome == "accurate"
    assert judge(wrong).outcome == "silent"


def test_case_without_a_reference_is_not_taken_for_accurate():
    right = find("bar: damping", "b = 0.02 ft.lbf.s/rad, cvodes", "bar_on_frame/reduced")
    assert judge(replace(right, references=())).outcome == "unverified"


def test_hang_and_crash_of_a_child_are_counted_and_the_next_case_runs(tmp_path):
    file = tmp_path / "model.py"
    file.write_text("import os, time\ndef hangs(): time.sleep(600)\ndef dies(): os._exit(3)\n")
    good = find("crank: spin", "omega = 1e0 rad/s", "crank_shaft/driven")
    cases = [Case("own", name, f"{file}:{name}") for name in ("hangs", "dies")]
    findings = list(explore([*cases, good], timeout=8, jobs=1))
    assert [f.verdict.outcome for f in findings] == ["hang", "crash", "accurate"]
    assert "code 3" in findings[1].verdict.reason


def test_function_and_verb_have_one_limit_of_time(monkeypatch, capsys):
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
    assert f"for one case, s; {HANG:g}" in capsys.readouterr().out


def test_unknown_model_is_refused():
    with pytest.raises(UnknownName, match="did you mean bicycle"):
        select_cases(["bicicle"])


def test_verb_writes_table_file_and_map_and_ends_with_0(tmp_path, monkeypatch, capsys):
    chosen = [c for c in CASES if c.family == "crank: mass"][:3]
    monkeypatch.setattr("cosim.study.extremes.campaign.select_cases", lambda *_, **__: chosen)
    table, figure = tmp_path / "cases.csv", tmp_path / "map.png"
    code = main(["extremes", "-q", "--output-file", str(table), "--figure", str(figure)])
    assert code == 0
    assert "crank: mass" in capsys.readouterr().out
    assert len(table.read_text().splitlines()) == 4
    assert matplotlib.image.imread(figure).ndim == 3


def test_verb_ends_with_4_when_a_case_is_silent(monkeypatch, capsys):
    wrong = replace(find("crank: spin", "omega = 1e0 rad/s", "crank_shaft/driven"), bound=-1.0)
    monkeypatch.setattr("cosim.study.extremes.campaign.select_cases", lambda *_, **__: [wrong])
    assert main(["extremes", "-q"]) == 4


def test_summary_counts_every_outcome_and_names_the_worst():
    findings = [
        CaseFinding(Case("f", name, "m/x"), CaseEnding(outcome, error, "", 0.0))
        for name, outcome, error in (
            ("a", "accurate", 1e-9),
            ("b", "accurate", 1e-7),
            ("c", "failed", None),
        )
    ]
    (row,) = family_rows(findings)
    assert (row["cases"], row["accurate"], row["failed"], row["silent"]) == (3, 2, 1, 0)
    assert (row["worst error"], row["at"]) == (1e-7, "m/x, b")


def test_map_tells_which_value_and_which_solver_ended_how():
    findings = [
        CaseFinding(
            Case("spin", f"omega = {v}, {s}", "m/x", solver=s), CaseEnding(o, None, "", 0.0)
        )
        for v, s, o in (("1", "erk", "accurate"), ("2", "erk", "failed"), ("2", "idas", "silent"))
    ]
    (axis,) = draw_map(findings).get_axes()
    assert [label.get_text() for label in axis.get_xticklabels()] == ["omega = 1", "omega = 2"]
    assert [label.get_text() for label in axis.get_yticklabels()] == ["x, erk", "x, idas"]
    places = [tuple(int(c[0]) for c in line.get_data()) for line in axis.lines]
    assert places == [(0, 0), (1, 0), (1, 1)]
    assert [text.get_text() for text in axis.texts] == ["f", "S"]  # readable without colour


def test_map_shows_each_outcome_in_its_own_colour(tmp_path):
    findings = [CaseFinding(Case("f", o, "m/x"), CaseEnding(o, None, "", 0.0)) for o in OUTCOMES]
    (path,) = save([draw_map(findings)], str(tmp_path / "map.png"))
    pixels = matplotlib.image.imread(path)[..., :3].reshape(-1, 3)
    assert len(np.unique((pixels * 8).astype(int), axis=0)) > len(OUTCOMES)


@pytest.mark.parametrize(
    ("family", "name", "model"),
    [
        ("bicycle: speed", "0 m/s, idas", "bicycle/multipliers"),
        ("mass ratios", "m x 1e-09", "bar_on_frame/two_body"),
        ("mass ratios", "bar_mass x 1e-06", "disk_two_bars/multipliers"),
    ],
)
def test_idas_starts_from_consistent_slopes_where_its_own_search_fails(family, name, model):
    assert judge(find(family, name, model)).outcome == "accurate"
