"""Unknowns in their nominal values, so that one absolute tolerance fits all of them.

As in FMUs, whose co-simulation solver counts like that. What counts as 1 is a power of two:
dividing by it and multiplying again changes no bit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import log2

import casadi as ca
import numpy as np
from casadi import DM, SX

from casadi_models.dae import Dae, Start, Variable
from cosim.arrays import Vector
from cosim.integrate.engine import Problem
from cosim.integrate.solver import Solver
from cosim.memo import kept_per_thread

NOT_GIVEN = 1.0  # the nominal value of a variable that has none of its own
_SMALL_SHARE = 1e-3  # states that stay below get a nominal value of their own
_SAMPLES = 16  # of a state, in which most are seen not to
NOISE = 1e-7  # what states that begin at 0 may reach without being meant


@dataclass(frozen=True)
class Nominal:
    """What counts as 1 in the error control of a run, SI: powers of two.

    Attributes:
        x, z: Of states and algebraic unknowns.
    """

    x: tuple[float, ...]
    z: tuple[float, ...]

    @classmethod
    def declared(cls, dae: Dae) -> "Nominal":
        """Return the nominal values that a model has."""
        return _declared(dae)

    @classmethod
    def none(cls, dae: Dae) -> "Nominal":
        """Return those of solvers without error control: 1."""
        return _none(dae)

    @cached_property
    def in_si(self) -> bool:
        """Whether everything counts in SI units."""
        return {*self.x, *self.z} <= {1.0}

    @cached_property
    def columns(self) -> tuple[Vector, Vector]:
        """Of states and algebraic unknowns, (nx, 1) and (nz, 1)."""
        return np.array(self.x).reshape(-1, 1), np.array(self.z).reshape(-1, 1)

    def from_start(self, dae: Dae, z0: Vector) -> "Nominal":
        """Return them with those of algebraic unknowns that nobody gave, by their start."""
        if not dae.algebraics:
            return self
        z = zip(dae.algebraics, self.z, np.abs(z0), strict=True)
        return replace(self, z=tuple(n if given(v) else power(max(n, size)) for v, n, size in z))

    def from_run(self, dae: Dae, states: Vector, algebraics: Vector) -> "Nominal":
        """Return them with those of small states that nobody gave, by what they reached.

        Args:
            dae: The model.
            states, algebraics: The run, (nx, n) and (nz, n).
        """
        found = list(self.x)
        for i in _not_given(dae):
            row, most = states[i], _SMALL_SHARE * self.x[i]
            if np.abs(row[:: len(row) // _SAMPLES + 1]).max() >= most:
                continue
            size = np.abs(row).max()
            meant = size > NOISE or (dae.states[i].start_kind is Start.EXACT and row[0] != 0)
            if 0 < size < most and meant:
                found[i] = power(size)
        return replace(self, x=tuple(found))

    def from_failure(self, dae: Dae, states: Vector, algebraics: Vector) -> "Nominal":
        """Return them with those of algebraic unknowns that nobody gave, by the largest of a unit.

        What begins at 0 shows nothing of its size; others of its unit do. See `from_run`.
        """
        largest: dict[str, float] = {}
        for v, row in zip(dae.algebraics, algebraics, strict=True):
            largest[v.unit] = max(largest.get(v.unit, 0.0), np.abs(row).max(initial=0.0))
        z = zip(dae.algebraics, self.z, strict=True)
        return replace(
            self, z=tuple(n if given(v) else max(n, power(largest[v.unit] or n)) for v, n in z)
        )

    def unlike(self, dae: Dae, other: "Nominal") -> Mapping[str, float]:
        """Return by name what another one has elsewhere."""
        both = zip((*dae.states, *dae.algebraics), self.x + self.z, other.x + other.z, strict=True)
        return {v.name: after for v, before, after in both if before != after}


@kept_per_thread(16)
def _declared(dae: Dae) -> Nominal:
    x, z = (tuple(power(v.nominal) for v in group) for group in (dae.states, dae.algebraics))
    return Nominal(x, z)


@kept_per_thread(16)
def _none(dae: Dae) -> Nominal:
    return Nominal((1.0,) * len(dae.states), (1.0,) * len(dae.algebraics))


@kept_per_thread(16)
def _not_given(dae: Dae) -> tuple[int, ...]:
    return tuple(i for i, variable in enumerate(dae.states) if not given(variable))


def given(variable: Variable) -> bool:
    """Tell whether a variable has a nominal value of its own."""
    return variable.nominal != NOT_GIVEN


def power(size: float) -> float:
    """Return the power of two next to a positive size."""
    return float(2.0 ** round(log2(size)))


def in_nominal_values(
    problem: Problem, solver: Solver, nominal: Nominal
) -> tuple[Problem, Nominal]:
    """Return a problem as a solver takes it, and what its unknowns are to be divided by.

    One that counts in nominal values by itself takes the equations as they are: as dividing by
    powers of two changes no bit, its steps are those of the rewritten ones.
    """
    if solver.counts_in_nominal:
        return replace(problem, nominal=nominal.x), Nominal.none(problem.dae)
    return replace(problem, dae=scaled(problem.dae, nominal)), nominal


def in_values_of_a_run(
    problem: Problem, solver: Solver, nominal: Nominal
) -> tuple[Problem, Nominal, Vector]:
    """Return the same as `in_nominal_values`, and further parameters that its engine takes.

    These are the nominal values of algebraic unknowns that nobody gave: they follow from the start,
    and one library is to do for every start.
    """
    dae = problem.dae
    found = tuple(i for i, v in enumerate(dae.algebraics) if not given(v))
    if solver.counts_in_nominal or not found:
        return *in_nominal_values(problem, solver, nominal), np.empty(0)
    known = replace(nominal, z=tuple(1.0 if i in found else n for i, n in enumerate(nominal.z)))
    sized = _sized(scaled(dae, known), found)
    return replace(problem, dae=sized), nominal, np.array([nominal.z[i] for i in found])


@kept_per_thread(16)
def _sized(dae: Dae, which: tuple[int, ...]) -> Dae:
    """Return a model some of whose algebraic unknowns are measured in further parameters."""
    rows, sizes = list(which), SX.sym("size", len(which))
    z = SX(dae.z)
    z[rows] = sizes * dae.z[rows]
    ode, alg = ca.substitute([dae.ode, dae.alg], [dae.z], [z])
    more = (Variable(f"size_{i}", "1", "what counts as 1 of an unknown", 1.0) for i in which)
    p = ca.vertcat(dae.p, sizes)
    return replace(dae, p=p, parameters=(*dae.parameters, *more), ode=ode, alg=alg)


@kept_per_thread(16)
def scaled(dae: Dae, nominal: Nominal) -> Dae:
    """Return a model whose states and algebraic unknowns are measured in nominal values.

    What solvers need is rewritten: equations and invariants; outputs, limits and starts are not.
    """
    if nominal.in_si:
        return dae
    x, z = DM(nominal.x), DM(nominal.z)

    def rewritten(*expressions: SX) -> list[SX]:
        return ca.substitute([*expressions], [dae.x, dae.z], [x * dae.x, z * dae.z])

    ode, alg = rewritten(dae.ode, dae.alg)
    invariants = []
    for invariant in dae.invariants:
        residual, sizes = rewritten(invariant.residual, invariant.sizes)
        moved = sizes / x[list(invariant.states)]
        invariants.append(replace(invariant, residual=residual, sizes=moved))
    return replace(dae, ode=ode / x, alg=alg, invariants=tuple(invariants))
