"""What a model description does not list has no influence: the binary's derivatives, all pairs."""

import fmpy
import numpy as np
import pytest
from helpers.fmi_cases import VERSIONS
from helpers.samples import sampled

import casadi_models
from cosim.fmi.archive import DESCRIPTION, unpacked
from cosim.fmi.check.parsed import Description, parse

EVERY = pytest.mark.parametrize("name", sampled(casadi_models.CATALOG))
ROUNDING = 1e-9  # of a derivative in nominal values; measured 0
# Listed, but no influence found: terms that cancel, factors that are 0. Measured 0 to 5 %, 16 % for
# the crank shaft, which turns at a constant rate.
CANCELLING = 0.2


def knowns(described: Description) -> list[int]:
    """Return time, states, inputs and the parameters that count as knowns."""
    variables = described.variables
    states = {v.derivative_of for v in variables}
    return [
        i
        for i, v in enumerate(variables)
        if i in states
        or v.causality in ("independent", "input")
        or (v.causality == "parameter" and (described.version == "3" or v.variability == "tunable"))
    ]


def partials(instance, unknowns: list[int], known: int) -> np.ndarray:
    return np.array(instance.getDirectionalDerivative(unknowns, [known], [1.0]))


def check(described: Description, sections, columns: dict[int, np.ndarray]) -> float:
    """Return which part of what is listed has no influence; nothing else may have one."""
    entries = [u for name in sections for u in described.sections[name]]
    listed = idle = 0
    for row, unknown in enumerate(entries):
        for known, column in columns.items():
            if known in unknown.needs:
                listed += 1
                idle += column[row] == 0
            else:
                names = described.variables[unknown.position].name, described.variables[known].name
                assert abs(column[row]) <= ROUNDING, names
    return idle / listed


@pytest.mark.slow_rows(
    "crank_shaft/multipliers-3", "bicycle/multipliers-3", "double_pendulum/quaternion-3"
)
@VERSIONS
@EVERY
def test_unlisted_pairs_have_no_derivative(name, fmi, exported):
    rng = np.random.default_rng(11)
    with unpacked(exported(name, fmi)) as folder:
        description = fmpy.read_model_description(str(folder))
        described = parse((folder / DESCRIPTION).read_bytes())
        instance = fmpy.instantiate_fmu(str(folder), description, "ModelExchange")
        if fmi == 2:
            instance.setupExperiment()
            instance.enterInitializationMode()
        else:
            instance.enterInitializationMode(startTime=0.0)
        starting = {i for i, v in enumerate(described.variables) if v.initial == "exact"}
        starting |= {i for i, v in enumerate(described.variables) if v.causality == "input"}
        unknowns = [u.position for u in described.sections["InitialUnknowns"]]
        idle = check(
            described,
            ["InitialUnknowns"],
            {k: partials(instance, unknowns, k) for k in {0, *starting}},
        )
        assert idle < 1  # some cancel at the start: sin(0)

        instance.exitInitializationMode()
        instance.enterContinuousTimeMode()
        states = [v.derivative_of for v in described.variables if v.derivative_of is not None]
        nominal = np.array([float(described.variables[i].texts.get("nominal", 1)) for i in states])
        read = instance.getReal if fmi == 2 else instance.getFloat64
        x = np.array(read(states)) + 0.05 * nominal * rng.standard_normal(len(states))
        if states:
            instance.setContinuousStates(np.ctypeslib.as_ctypes(x), len(x))
        instance.setTime(0.3)
        sections = ["Outputs", "Derivatives"]
        unknowns = [u.position for name in sections for u in described.sections[name]]
        columns = {k: partials(instance, unknowns, k) for k in knowns(described)}
        instance.freeInstance()
    assert check(described, sections, columns) <= CANCELLING
