"""`linearize`: the linear system at a state, or eigenvalues along a parameter."""

import os
from collections.abc import Mapping, Sequence
from typing import TypedDict, Unpack, overload

from casadi_models.dae import Dae
from cosim.errors import UsageError
from cosim.model.catalogue import load
from cosim.study.linearize.along import EigenvalueSweep, eigenvalue_sweep
from cosim.study.linearize.linearization import Linearization
from cosim.study.linearize.point import linearized


class PointKeywords(TypedDict, total=False):
    """Keywords of one linear system; see `linearize`."""

    at: str | float
    start_values: Mapping[str, float] | None
    outputs: Sequence[str] | None
    solver: str | None
    relative_tolerance: float | None


@overload
def linearize(
    model: Dae | str | os.PathLike[str], *, along: None = None, **options: Unpack[PointKeywords]
) -> Linearization: ...


@overload
def linearize(
    model: Dae | str, *, along: Mapping[str, Sequence[float]], **options: Unpack[PointKeywords]
) -> EigenvalueSweep: ...


def linearize(
    model: Dae | str | os.PathLike[str],
    *,
    along: Mapping[str, Sequence[float]] | None = None,
    **options: Unpack[PointKeywords],
) -> Linearization | EigenvalueSweep:
    """Return the linear system near a state: x' = A x + B u, y = C x + D u; or one per value.

    Along a parameter, groups of states that do not influence each other at any of its values are
    treated separately, so that the zero eigenvalues of states without a restoring force do not
    interfere.

    Args:
        model: A `Dae`, the name of a model, or the file of an FMU, whose directional derivatives
            give the matrices.
        along: One parameter, state (its initial value) or input by name with its values: two or
            more, increasing or decreasing, SI. None: one linear system.
        options: `at`: "start" (the default), the initial state; "equilibrium", which Newton's
            method finds from there, and in which states that influence nothing else may move on; or
            a time of a run, s. `start_values`: values by name that replace initial values,
            parameters or inputs, SI. `outputs`: names of y; all outputs of the model when None.
            `solver`, `relative_tolerance`: settings of the run up to a time; see `simulate`.

    Raises:
        UnknownName: A name does not exist.
        UsageError: An FMU can be linearized at its initial state only, and not along a parameter;
            or `along` does not name one variable.
        ParameterError: The values along a parameter do not increase or decrease.
        InitialConditionError: The initial values contradict the constraints, or there is no
            equilibrium near them; or an eigenvalue crosses the imaginary axis at an unsteady state.
        CosimError: See `simulate` and `linearized_fmu`.

    Example:
        >>> linearize("bar_on_frame/reduced", outputs=["theta"]).A.shape
        (4, 4)
        >>> found = linearize("bar_on_frame/reduced", along={"b": [0.1, 0.2]}, outputs=["theta"])
        >>> len(found.values)
        2
    """
    if along is None:
        return linearized(model, **options)
    if not isinstance(along, Mapping) or len(along) != 1:
        raise UsageError.of_type("linearize: along", along, "one name with its values")
    ((name, values),) = along.items()
    dae = load(model) if isinstance(model, str) and not model.endswith(".fmu") else model
    if not isinstance(dae, Dae):
        raise UsageError(f"{model}: an FMU is linearized at one state; leave along out")
    given = options.get("start_values") or {}

    def point(value: float) -> Linearization:
        at_value: PointKeywords = {**options, "start_values": {**given, name: value}}
        return linearized(dae, **at_value)

    return eigenvalue_sweep(dae, name, values, point)
