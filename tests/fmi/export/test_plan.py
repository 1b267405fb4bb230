"""The plan of an FMU: which files of the package it contains, and why."""

import pytest
from helpers.event_models import everything
from helpers.small_models import decay, growing

from cosim.codegen.c_sources import runtime_sources, solver_sources
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.plan import PARTS, planned


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.why)
def test_every_pattern_of_a_part_names_files(part):
    """Otherwise a renamed file of fmu/runtime would be in every FMU."""
    names = [entry for entry in (*runtime_sources(), *solver_sources()) if part.contains(entry)]
    assert len(names) >= len(part.files)


@pytest.mark.parametrize(("fmi", "other"), [(2, "fmi3"), (3, "fmi2")])
def test_an_fmu_has_the_functions_of_its_own_version_only(fmi, other):
    plan = planned(decay(), FmuOptions(fmi))
    assert f"fmi{fmi}.c" in plan.runtime
    assert not [name for name in plan.runtime if name.startswith(other)]


@pytest.mark.parametrize(
    ("solver", "has"), [("dop853", "integration_dop853.c"), ("rosenbrock", "integration_step.c")]
)
def test_an_fmu_has_one_solver_and_no_files_of_events_without_events(solver, has):
    plan = planned(decay(), FmuOptions(solver=solver))
    assert [name for name in plan.runtime if name.startswith("integration_")] == [has]
    assert ("dop853.h" in plan.headers) is (solver == "dop853")
    assert "modes.c" not in plan.runtime
    assert "laws.h" not in plan.headers


@pytest.mark.parametrize("model", [everything(), growing()])
def test_a_second_plan_of_a_model_computes_no_equations(model):
    one, other = (planned(model, FmuOptions()) for _ in range(2))
    assert one.laws is other.laws
