"""`equilibrium`: the steady or periodic motion that Newton's method finds near a state."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.initialization import law_of_knowns
from cosim.errors import InitialConditionError
from cosim.model.values import Values
from cosim.series.samples import ROUNDING_OF_OTHERS
from cosim.study.linearize.local import at_point, followed, influence, reject_no_number
from cosim.study.linearize.period_map import ACCURACY, PeriodMap
from cosim.study.linearize.spectrum import rate_sizes, without_influence
from cosim.text import counted, with_unit

MOST_NEWTON_STEPS = 60
AT_REST = 1e-11  # largest rate of a state at rest, of those that states of their size make
SAME = 1e-6  # relative difference of states that rounding of their rates may leave open


def equilibrium(
    dae: Dae, time: float, x: Vector, values: Values, over: PeriodMap | None
) -> tuple[Vector, str]:
    """Return the steady state that Newton's method reaches, and its description.

    If several states can move, the step of least norm is taken. Invariants stay zero. Cyclic
    states retain their values, and their rates need not vanish.

    Args:
        dae: The model.
        time: s, at which an equilibrium is sought where the equations contain time.
        x: The state at which Newton's method begins.
        values: Values of inputs and parameters.
        over: The map over a period for a periodic motion; None for an equilibrium.

    Raises:
        InitialConditionError: There is none.
    """
    depends = influence(dae) if over is None else over.influence
    cyclic, driven = without_influence(depends), [bool(row.any()) for row in depends]
    free = [i for i in range(len(x)) if i not in cyclic]
    search = _Search(dae, time, values, over)
    # A state whose rate depends on no state, e.g. a prescribed speed, retains its value, unless
    # there is no equilibrium with it
    try:
        return search.rest(x, free, [i for i in free if driven[i]])
    except InitialConditionError:
        return search.rest(x, free, free)


@dataclass(frozen=True)
class _Search:
    dae: Dae
    time: float
    values: Values
    over: PeriodMap | None

    @property
    def kind(self) -> str:
        return "an equilibrium" if self.over is None else "a periodic motion"

    def motion(self, x: Vector) -> tuple[Vector, Vector]:
        """Return rates, or their mean over a period, and their derivatives by the states."""
        if self.over is not None:
            after = self.over(x)
            moved, slopes = after.x - x, after.by_x - np.eye(len(x))
            return moved / self.over.period, slopes / self.over.period
        own, u, _ = followed(self.dae, self.time, x, self.values)
        rates, _, jacobian = at_point(own, (), self.time, x, replace(self.values, u=u))
        return rates, jacobian[: len(x), : len(x)]

    def rest(self, x: Vector, resting: list[int], movable: list[int]) -> tuple[Vector, str]:
        """Return the state in which the `resting` states are at rest, and its description.

        Newton's method changes the `movable` ones only; both are indices of states.
        """
        dae, values = self.dae, self.values
        sizes = np.array([v.nominal for v in dae.states])
        nominal = sizes[movable]
        residual = ca.vertcat(SX(0, 1), *(invariant.residual for invariant in dae.invariants))
        law = law_of_knowns(dae, "law", residual, ca.jacobian(residual, dae.x))

        def defect(x: Vector) -> tuple[Vector, Vector, Vector]:
            rates, jacobian = self.motion(x)
            left, slope = (np.array(block) for block in law(self.time, x, values.u, values.p))
            rows = np.concatenate(((rates / sizes)[resting], left.ravel()))
            parts, reach = ((jacobian / sizes[:, None])[resting], slope), np.fmax(np.abs(x), sizes)
            size = np.concatenate([rate_sizes(part, reach) for part in parts])
            size = np.where(size, size, np.where(rows, np.abs(rows), 1.0))
            return rows, np.vstack(parts)[:, movable] * nominal, size

        start, (rows, slope, size) = x, defect(x)
        moving = [dae.states[i].name for i in resting]
        meanings = [f"{name}_dot" for name in moving] + ["a constraint"] * (len(rows) - len(moving))
        knowns = [dae.states[i].name for i in movable]
        reject_no_number(dae.full_name, slope, meanings, knowns, "the initial state")
        for step in range(MOST_NEWTON_STEPS):
            least = AT_REST * size
            if self.over is not None:
                least[: len(moving)] = ACCURACY / self.over.period
            if np.all(np.abs(rows) <= least):
                return x, self._described(start, x, step)
            change = -np.linalg.lstsq(slope / size[:, None], rows / size, rcond=1e-12)[0]
            ends = np.all(np.abs(rows + slope @ change) <= least)
            change = change * nominal
            ends = ends and np.all(np.abs(change) <= SAME * np.fmax(np.abs(x), sizes)[movable])
            for _ in range(30):
                trial = x.copy()
                trial[movable] += change
                found = defect(trial)
                is_nearer = np.linalg.norm(found[0] / size) < np.linalg.norm(rows / size)
                if is_nearer and np.isfinite(found[1]).all():
                    break
                change = change / 2
            else:
                if ends:  # the rates are rounding errors of larger terms
                    return x, self._described(start, x, step)
                break
            x, (rows, slope, size) = trial, found
        noun, worst = self.kind.split(" ", 1)[1], int(np.abs(rows).argmax())
        why = f"a constraint is not fulfilled (by {rows[worst]:.3g}"
        if worst < len(moving):
            rate = f"its rate is {rows[worst]:.3g} nominal values per second"
            why = f"{moving[worst]} cannot come to rest ({rate}"
        raise InitialConditionError(
            f"{dae.full_name}: there is no {noun} near the initial state: {why} where Newton's "
            "method stops); start nearer to it, or change the parameters and inputs that drive the "
            "model"
        )

    def _described(self, start: Vector, x: Vector, steps: int) -> str:
        """Return the description of a state that was reached from the initial one."""
        moved = np.abs(x - start) / [v.nominal for v in self.dae.states]
        if not moved.any():
            return f"its initial state, {self.kind}"
        most = int(moved.argmax())
        state, way = self.dae.states[most], abs(x[most] - start[most])
        reached = x[most] if abs(x[most]) > ROUNDING_OF_OTHERS * way else 0.0
        return (
            f"{self.kind}, {counted(steps, 'step')} of Newton's method from the initial state "
            f"({state.name} = {with_unit(reached, state.unit)} instead of {start[most]:.6g})"
        )
