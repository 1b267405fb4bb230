"""Events of an FMU: frozen equations, and pulses."""

from collections.abc import Mapping
from dataclasses import replace
from warnings import warn

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Start, Variable
from casadi_models.dae.hybrid import Hybrid, hybrid
from cosim.arrays import Vector
from cosim.codegen.landmarks import Landmarks, landmarks
from cosim.codegen.terms import pulse_parameters, pulse_times
from cosim.errors import UsageError
from cosim.memo import cached_per_thread

LEAST_STEPS = 50  # of the solver in a model's span
_SAME_TIME = 1e-9  # relative distance of times that importers take as one


def fmu_pulses(dae: Dae) -> Vector:
    """Return the times at which steps must end for a solver to see all terms of time, s."""
    p = np.array([np.nan if v.start is None else v.start for v in dae.parameters], dtype=float)
    span = dae.experiment.stop_time
    known = landmarks(dae)
    slopes = ca.jacobian(known.arguments, dae.t)
    line = ca.Function("line", [dae.t, dae.x, dae.u, dae.z, dae.p], [known.arguments, slopes])
    value, slope = (np.array(row).ravel() for row in line(0, 0, 0, 0, p))
    with np.errstate(divide="ignore", invalid="ignore"):
        relations = -value / slope  # infinite for those of states
    others = np.append(known.times, relations[np.isfinite(relations)])
    sampled = pulse_times(dae, p, 0.0, span)
    gaps = np.abs(sampled[:, None] - others).min(axis=1, initial=np.inf)
    return np.union1d(known.times, sampled[gaps > _SAME_TIME * np.abs(sampled)])


def fmu_events(dae: Dae) -> Hybrid | None:
    """Return the frozen equations of a model; None if it has neither events nor pulses.

    Their last outputs are the event indicators: how far each argument is within its mode.

    Raises:
        UsageError: The model uses a reserved variable name.
    """
    system, places = _frozen(dae)
    for name in places.passed:
        warn(
            f"{dae.full_name}: terms of {name} change in places that the FMU does not name; an "
            "importer's solver, or fixed steps, may step over some: give it a largest step",
            stacklevel=2,
        )
    return system


def has_fmu_events(dae: Dae) -> bool:
    """Return whether an FMU of a model has relations, events or pulses."""
    return _frozen(dae)[0] is not None


def fmu_warnings(dae: Dae) -> Mapping[str, SX]:
    """Return what to warn of where an expression of parameters is not positive."""
    system, places = _frozen(dae)
    found = dict(places.gentle)
    if system is None:
        return found
    known = landmarks(system.dae)
    sampled = {*pulse_parameters(system.dae)} if len(fmu_pulses(system.dae)) else set[str]()
    moving = sampled - {*known.followed} | {*known.given}
    for variable, p in zip(dae.parameters, ca.vertsplit(dae.p), strict=True):
        if variable.name in moving:
            found[f"{variable.name} moves a short change of the equations"] = SX(
                p == (variable.start or 0.0)
            )
    return found


@cached_per_thread(16)
def _frozen(dae: Dae) -> tuple[Hybrid | None, Landmarks]:
    """Return what `fmu_events` does, and where terms change."""
    system = hybrid(dae)
    system = system.blended() if system else Hybrid(dae, (), (), ())
    places = landmarks(system.with_conditions())
    system = system.watching_more(places.arguments, "place")
    if not (system.relations or system.events or len(fmu_pulses(system.dae))):
        return None, places
    smooth, modes = system.dae, ca.vertsplit(system.modes)
    rows, more = list[SX](), list[Variable]()
    for i, relation in enumerate(system.relations):
        if system.of_time[i]:
            continue
        value, mode, name = relation.argument, modes[i], f"event_indicator_{len(more) + 1}"
        meaning = f"positive while the mode of {system.described(i)} stays"
        rows.append(ca.fmin(value - mode, mode + 1 - value) if relation.floor else mode * value)
        more.append(Variable(name, "1", meaning, start_kind=Start.CALCULATED))
    names = {v.name for v in (*more, *smooth.inputs[len(dae.inputs) :])}
    for taken in {v.name for v in dae.variables} & names:
        raise UsageError(f"{dae.full_name} has a variable '{taken}' of its own; rename it")
    outputs = ca.densify(ca.vertcat(smooth.outputs, *rows))
    variables = (*smooth.output_variables, *more)
    dae = replace(smooth, outputs=outputs, output_variables=variables)
    return replace(system, dae=dae), places
