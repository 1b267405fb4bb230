"""A `Dae` as numbers, without a solver of the product, for tests of equations."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from casadi_models.dae import Dae

Vector = NDArray[np.float64]


class Equations:
    """dx/dt, algebraic unknowns and outputs of a `Dae` whose `alg` is linear in z.

    Calls take states, inputs and parameters by name, SI; what is not given has its start value.
    """

    def __init__(self, dae: Dae) -> None:
        self.dae = dae
        known = [dae.t, dae.x, dae.u, dae.p]
        matrix = ca.jacobian(dae.alg, dae.z)
        assert not ca.depends_on(matrix, dae.z)
        offset = ca.substitute(dae.alg, dae.z, ca.SX.zeros(dae.z.numel()))
        self._linear = ca.Function("linear", known, [matrix, -offset], {"cse": True})
        along = [ca.jtimes(dae.outputs, dae.x, dae.ode), ca.jtimes(dae.outputs, dae.t, ca.SX(1))]
        results = [dae.ode, dae.outputs, sum(along)]
        self._results = ca.Function("results", [*known, dae.z], results, {"cse": True})
        self._values = {v.name: v.start for v in (*dae.inputs, *dae.parameters)}
        self._values |= {v.name: x for v, x in zip(dae.states, dae.x_start, strict=True)}

    def __call__(self, **values: float) -> dict[str, float]:
        """Return every state, algebraic unknown and output."""
        x = self._columns(values)[0]
        z, _, outputs, _ = self._evaluate(0.0, *self._columns(values))
        return dict(zip(self._names(), [*x, *z, *outputs], strict=True))

    def rates(self, **values: float) -> dict[str, float]:
        """Return the time derivatives of states, and of outputs that hold no z."""
        _, ode, _, rates = self._evaluate(0.0, *self._columns(values))
        names = [v.name for v in (*self.dae.states, *self.dae.output_variables)]
        return dict(zip(names, [*ode, *rates], strict=True))

    def matrix(self, **values: float) -> NDArray[np.float64]:
        """Return d(alg)/dz."""
        return np.array(self._linear(0.0, *self._columns(values))[0])

    def run(
        self,
        stop_time: float,
        rtol: float = 1e-10,
        points: int = 201,
        atol: float | None = None,
        **values: float,
    ) -> dict[str, Vector]:
        """Integrate with SciPy's DOP853; return every variable and `time` at equal steps.

        The absolute tolerance is `rtol` times the nominal values when None.
        """
        start, u, p = self._columns(values)
        nominal = np.array([v.nominal for v in self.dae.states])
        times = np.linspace(0.0, stop_time, points)
        solution = solve_ivp(
            lambda t, x: self._evaluate(t, x, u, p)[1],
            (0.0, stop_time),
            start,
            method="DOP853",
            t_eval=times,
            rtol=rtol,
            atol=rtol * nominal if atol is None else atol,
        )
        assert solution.success, solution.message
        rows = []
        for t, x in zip(times, solution.y.T, strict=True):
            z, _, outputs, _ = self._evaluate(t, x, u, p)
            rows.append([*x, *z, *outputs])
        return {"time": times} | dict(zip(self._names(), np.array(rows).T, strict=True))

    def _names(self) -> list[str]:
        dae = self.dae
        return [v.name for v in (*dae.states, *dae.algebraics, *dae.output_variables)]

    def _columns(self, values: dict[str, float]) -> tuple[Vector, Vector, Vector]:
        unknown = set(values) - set(self._values)
        assert not unknown, f"{self.dae.full_name} has no {unknown}"
        merged = self._values | values
        groups = (self.dae.states, self.dae.inputs, self.dae.parameters)
        x, u, p = (np.array([merged[v.name] for v in group]) for group in groups)
        return x, u, p

    def _evaluate(self, t: float, x: Vector, u: Vector, p: Vector) -> list[Vector]:
        matrix, right = (np.array(block) for block in self._linear(t, x, u, p))
        z = np.linalg.solve(matrix, right).ravel() if self.dae.algebraics else np.empty(0)
        return [z, *(np.array(c).ravel() for c in self._results(t, x, u, p, z))]
