"""From CasADi's `DaeBuilder` to a `Dae`, so that its models take both roads, too."""

from math import isfinite
from typing import Any

import casadi as ca

from casadi_models.dae import Dae, Model
from cosim.errors import UsageError

_REFUSED = {"d": "discrete states", "c": "constants that are not parameters", "q": "quadratures"}


def from_dae_builder(builder: ca.DaeBuilder) -> Dae:
    """Return the DAE of a `casadi.DaeBuilder` with states, algebraics, inputs, parameters, outputs.

    Start values, units, display units, bounds, nominal values and descriptions come along; a
    variable without unit is a number, one without description is described by its name.

    Raises:
        UsageError: The builder holds events or discrete variables, a name or a unit is not
            allowed here, or its functions cannot be written out in scalar operations.
    """
    if not isinstance(builder, ca.DaeBuilder):
        raise UsageError.of_type("from_dae_builder", builder, "a casadi.DaeBuilder")
    name = builder.name()
    for kind, meaning in _REFUSED.items():
        if getattr(builder, kind)():
            raise UsageError(f"DaeBuilder {name}: it has {meaning}, which cannot be exported")
    if builder.nzero():
        raise UsageError(f"DaeBuilder {name}: it has events, which cannot be exported")
    try:
        return _converted(builder, name)
    except ValueError as error:  # begins with the name
        raise UsageError(f"DaeBuilder {error}") from error
    except RuntimeError as error:
        raise UsageError(f"DaeBuilder {name}: {' '.join(str(error).split())}") from error


def _converted(builder: ca.DaeBuilder, name: str) -> Dae:
    stop = builder.stop_time()
    model = Model(
        name,
        description=f"{name}, built with casadi.DaeBuilder",
        source="casadi.DaeBuilder",
        stop_time=stop if isfinite(stop) and stop > 0 else 10.0,
    )
    equations = builder.create(name, ["t", "x", "z", "u", "p"], ["ode", "alg", "y"]).expand()
    declared = {
        kind: ca.vertcat(
            ca.SX(0, 1),
            *(
                declare(
                    each,
                    _unit(builder, each),
                    _start(builder, each),
                    _meaning(builder, each),
                    **_facts(builder, each),
                )
                for each in getattr(builder, kind)()
            ),
        )
        for kind, declare in (
            ("x", model.state),
            ("z", model.algebraic),
            ("u", model.input),
            ("p", model.parameter),
        )
    }
    ode, alg, outputs = equations(model.t, *declared.values())
    model.derivative(declared["x"], ode)
    model.equation(alg)
    for each, expression in zip(builder.y(), ca.vertsplit(outputs), strict=True):
        own = _facts(builder, each)
        if each not in (*builder.x(), *builder.z()):
            model.output(each, _unit(builder, each), expression, _meaning(builder, each), **own)
    return model.freeze()


def _unit(builder: ca.DaeBuilder, name: str) -> str:
    return builder.unit(name) or "1"


def _meaning(builder: ca.DaeBuilder, name: str) -> str:
    return builder.description(name) or name


def _start(builder: ca.DaeBuilder, name: str) -> float:
    return _scalar(builder.start(name))


def _facts(builder: ca.DaeBuilder, name: str) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "minimum": _scalar(builder.min(name)),
        "maximum": _scalar(builder.max(name)),
    }
    nominal = _scalar(builder.nominal(name))
    if nominal > 0:
        facts["nominal"] = nominal
    if builder.display_unit(name):
        facts["display_unit"] = builder.display_unit(name)
    return facts


def _scalar(value: float | list[float]) -> float:
    """Return the number of a scalar variable, which CasADi wraps in a list."""
    return float(value[0] if isinstance(value, list) else value)
