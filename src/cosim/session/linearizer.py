"""`Linearizer`: A, B, C, D of an instance, by its directional derivatives."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import FmuError, UnknownName, UsageError
from cosim.fmi.run.description import by_name
from cosim.fmi.run.request import output_names
from cosim.integrate.modes import hybrid
from cosim.model.catalogue import observable
from cosim.model.values import Values
from cosim.session.calls import Jacobians, PreparedCalls
from cosim.session.values import inputs_of
from cosim.study.linearize.local import local_system, with_kinks_of


class LinearSystem(NamedTuple):
    """Matrices of x' = A x + B u, y = C x + D u for small deviations from the present state."""

    A: Vector
    B: Vector
    C: Vector
    D: Vector


class Linearizer:
    """Prepared calls of the directional derivatives.

    Args:
        name: Of the session, for errors.
        description: Of fmpy.
        calls: Of the instance.
        outputs: Names of y.
        dae: Its model; None of a file.

    Attributes:
        outputs: Names of y.

    Raises:
        FmuError: The FMU has no directional derivatives, or no states.
        UnknownName, UsageError: An output does not exist, or an input is no real number.
    """

    def __init__(
        self,
        name: str,
        description: Any,
        calls: PreparedCalls,
        outputs: Sequence[str],
        dae: Dae | None,
    ) -> None:
        rates = [item.variable for item in description.derivatives]
        if not description.coSimulation.providesDirectionalDerivative or not rates:
            raise FmuError(
                f"{name} has no directional derivatives by its states; compare steps from a saved "
                "state instead"
            )
        variables = by_name(description)
        inputs = inputs_of(description)
        self.outputs = tuple(output_names(name, variables, outputs))
        known = [n for n, v in variables.items() if v.causality == "output"]
        known += [v.name for rate in rates for v in (rate.derivative, rate)]
        for output in self.outputs:
            UnknownName.reject(name, "output", known, output)
        if any(v.dimensions for v in description.modelVariables):
            raise FmuError(
                f"{name} has arrays, whose derivatives are not read; linearize its model"
            )
        for v in inputs:
            if v.type not in ("Real", "Float64"):
                raise UsageError(f"{name}: the input {v.name} is no real number")
        knowns = [*(rate.derivative for rate in rates), *inputs]
        self._states = len(rates)
        self._rates = Jacobians(calls, rates, knowns)
        shown = [variables[n] for n in self.outputs]
        self._lower: Vector = np.zeros((len(shown), len(knowns)))
        self._computed = list[int]()
        places = {v.name: column for column, v in enumerate(knowns[: len(rates)])}
        for row, v in enumerate(shown):
            if v.name in places:  # a state depends on itself alone
                self._lower[row, places[v.name]] = 1.0
            else:
                self._computed.append(row)
        self._outputs = Jacobians(calls, [shown[row] for row in self._computed], knowns)
        self._corners = None if dae is None else _with_corners(dae, self.outputs)

    def evaluate(self) -> int:
        """Compute the matrices at the present state; return the worst status."""
        return max(self._rates.evaluate(), self._outputs.evaluate())

    def system(self) -> LinearSystem:
        """Return the matrices."""
        n = self._states
        upper = self._rates.values.T.copy()
        lower = self._lower.copy()
        lower[self._computed] = self._outputs.values.T
        return LinearSystem(upper[:, :n], upper[:, n:], lower[:, :n], lower[:, n:])

    def reject_corner(self, time: float, get: Callable[[Sequence[str]], Vector]) -> None:
        """Raise InitialConditionError if a derivative is another one on each side of the values.

        Args:
            time: The present time, s.
            get: Returns values by name.
        """
        if self._corners is None:
            return
        dae, names = self._corners
        groups = dae.states, dae.parameters, dae.inputs
        values = Values(*(get([v.name for v in own]) if own else np.empty(0) for own in groups))
        local_system(dae, names, time, values.x, values, f"{time:.12g} s")


def _with_corners(dae: Dae, outputs: Sequence[str]) -> tuple[Dae, tuple[str, ...]] | None:
    """Return a model with the outputs that it computes; None if nothing switches in them."""
    names = tuple(name for name in outputs if name in observable(dae))
    system = hybrid(with_kinks_of(dae, names))
    return None if system is None or not system.relations else (dae, names)
