"""Whether to compile a model's equations for a run, where the caller leaves that open.

Small models are compiled: it takes seconds, once. Large ones are interpreted until what that has
taken, with the run that is wanted, would have paid for the compiler: nobody waits for longer than
twice the better way, whatever is still to come.

Source  Karlin, Manasse, Rudolph & Sleator, Algorithmica 3, 1988, 79-119 (the ski-rental problem).
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import casadi as ca

from casadi_models.dae import Dae
from cosim.codegen.compiler import NotKept, has_compiler, only_kept
from cosim.codegen.externals import sources_beside
from cosim.codegen.functions import is_large
from cosim.errors import UsageError
from cosim.integrate.solver import Solver
from cosim.memo import kept_per_thread

SMALL = 5000  # operations of dx/dt and the algebraic equations

# Measured with GCC 12.2 at -O1 and with CasADi's virtual machine, s per operation
COMPILING = 4e-4
INTERPRETING = 1e-8

_LOOP = 3  # operations of a directional derivative for each of the equations
_CALLS = 800  # of a run that begins at rest and ends soon; more with every output
_CALLS_PER_OUTPUT = 5
_CALLS_PER_JACOBIAN = 15


@dataclass
class Spent:
    """What runs of a model have taken, interpreted, s."""

    seconds: float = 0.0


@dataclass(frozen=True)
class Choice:
    """Whether to compile, and why not.

    Attributes:
        compiled: Whether.
        note: What a run that is interpreted says of it; empty where nothing is to be said.
        spent: What an interpreted run adds its time to.
    """

    compiled: bool
    note: str = ""
    spent: Spent | None = None

    def add(self, seconds: float | None) -> None:
        """Add what a run has taken."""
        if self.spent is not None:
            self.spent.seconds += seconds or 0.0


def settled(dae: Dae, solver: Solver) -> Choice | None:
    """Return the choice where what runs take does not matter, else None.

    Raises:
        MissingTool: $CC names a compiler that is not there.
    """
    if not has_compiler():
        return Choice(False)
    if solver.compiled_only:
        return Choice(True)
    if reason := _without_code(dae):
        return Choice(False, f"interpreted: {reason}")
    return Choice(True) if _operations(dae) <= SMALL else None


def worthwhile(
    dae: Dae, solver: Solver, points: int, build: Callable[[], object], runs: int = 1
) -> Choice:
    """Decide for a run with a solver.

    Args:
        dae: The model.
        solver: How it is integrated.
        points: Number of output times.
        build: Makes what a compiled run needs; where the cache holds all of it, there is no
            question.
        runs: How many are wanted at least.

    Raises:
        MissingTool: $CC names a compiler that is not there.
    """
    if (choice := settled(dae, solver)) is not None:
        return choice
    operations = _operations(dae)
    calls = _CALLS + _CALLS_PER_OUTPUT * points
    jacobian = _jacobian_size(dae) if solver.uses_jacobian else 0.0
    code = operations * (1 + (_LOOP if is_large(dae) else jacobian))
    compiling = COMPILING * code
    once = runs * INTERPRETING * operations * calls * (1 + jacobian / _CALLS_PER_JACOBIAN)
    spent = _spent(dae)
    if spent.seconds + once > compiling:
        return Choice(True)
    with suppress(NotKept), only_kept():
        build()
        return Choice(True)
    note = (
        f"interpreted: {operations} operations take about {_rounded(compiling)} s to compile, "
        f"this run about {_rounded(once)} s; compiled=True compiles them"
    )
    return Choice(False, note, spent)


@kept_per_thread(64)
def _spent(dae: Dae) -> Spent:
    return Spent()


@kept_per_thread(64)
def _without_code(dae: Dae) -> str:
    """Say which library the model calls whose C code is not at hand; empty where there is none."""
    try:
        sources_beside(ca.Function("laws", dae.arguments, [dae.ode, dae.alg, dae.outputs]))
    except UsageError as error:
        return str(error)
    return ""


@kept_per_thread(64)
def _operations(dae: Dae) -> int:
    return int(ca.Function("laws", dae.arguments, [dae.ode, dae.alg]).n_instructions())


@kept_per_thread(64)
def _jacobian_size(dae: Dae) -> float:
    """Return what a Jacobian takes, in evaluations of the equations."""
    unknowns = ca.vertcat(dae.x, dae.z)
    pattern = ca.jacobian_sparsity(ca.vertcat(dae.ode, dae.alg), unknowns)
    groups = pattern.uni_coloring(pattern.T).size2()
    return float(_LOOP * groups if is_large(dae) else max(1, groups / 4))


def _rounded(seconds: float) -> str:
    return f"{max(seconds, 0.1):.1g}"
