"""Which solver an FMU carries for co-simulation."""

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.initialization import usual_start
from cosim.errors import UnknownName, UsageError
from cosim.fmi.export.sources.sensitivities import jacobian_function

# `dop853` is hand-written, in the runtime; the others are CasADi's.
DOP853, ERK, ROSENBROCK = CO_SIMULATION_SOLVERS = ("dop853", "erk", "rosenbrock")

# Decay rates times the output interval beyond which the steps of an explicit method, short for
# stability alone, cost more than the linear equations of an implicit one.
STIFF = 100.0

_LARGE = 200  # states: all eigenvalues of more take seconds
_KNOWN = 0.01  # residual of a mode, relative to its rate, with which that is known well enough


def solver_for(dae: Dae, wanted: str | None) -> str:
    """Return the wanted solver, or when None the one that suits the model at its start.

    Raises:
        UnknownName: There is no such solver.
        UsageError: It cannot solve for algebraic unknowns.
    """
    if wanted is None:
        stiff = fastest_decay(dae) * dae.experiment.output_interval > STIFF
        return ROSENBROCK if stiff else DOP853
    if wanted not in CO_SIMULATION_SOLVERS:
        raise UnknownName.among("cosim export", "solver", wanted, CO_SIMULATION_SOLVERS)
    if wanted == ERK and dae.algebraics:
        raise UsageError(
            f"{dae.full_name} has algebraic unknowns, which erk cannot solve for; take dop853 "
            "or rosenbrock"
        )
    return wanted


def uses_dop853(dae: Dae, solver: str) -> bool:
    """Tell whether the runtime's own solver is compiled; it needs something to integrate."""
    return solver == DOP853 and bool(dae.states)


def fastest_decay(dae: Dae) -> float:
    """Return the largest rate, 1/s, at which small changes of the start values die out.

    It is 0 where nothing dies out, or where there are no start values; of many states, it is
    known within a hundredth or so.
    """
    try:
        jacobian, _ = jacobian_function(dae)(0.0, *usual_start(dae))
    except RuntimeError:  # no solution; whoever runs the FMU is told why
        return 0.0
    square = np.array(jacobian.full())[:, : len(dae.states)]
    if not square.size or not np.isfinite(square).all():
        return 0.0
    rate = _fastest_of_many(square) if len(square) > _LARGE else None
    if rate is None:
        rate = -float(np.linalg.eigvals(square).real.min())
    return max(0.0, rate)


def _fastest_of_many(matrix: Vector, size: int = 60) -> float | None:
    """Return the largest decay rate of a large matrix, 1/s; None where a small one does not tell.

    Of vibrations, whose decay is slow beside them, it does not.

    Source  Arnoldi, Quarterly of Applied Mathematics 9, 1951, 17-29.
    """
    basis, small = np.zeros((size + 1, len(matrix))), np.zeros((size + 1, size))
    basis[0] = np.random.default_rng(0).standard_normal(len(matrix))
    basis[0] /= np.linalg.norm(basis[0])
    for k in range(size):
        image = matrix @ basis[k]
        for _ in range(2):  # once more, against rounding
            parts = basis[: k + 1] @ image
            image -= parts @ basis[: k + 1]
            small[: k + 1, k] += parts
        small[k + 1, k] = np.linalg.norm(image)
        if small[k + 1, k] <= 1e-12 * np.abs(small).max():  # nothing new: a start of few modes
            return None
        basis[k + 1] = image / small[k + 1, k]
    values, modes = np.linalg.eig(small[:size])
    fastest = int(values.real.argmin())
    rate, residual = -values[fastest].real, small[size, size - 1] * abs(modes[-1, fastest])
    return float(rate) if residual < _KNOWN * rate else None
