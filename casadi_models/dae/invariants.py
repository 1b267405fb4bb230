"""What every exact solution keeps at zero and a numerical one does not, and how it returns."""

from dataclasses import dataclass

from casadi import SX

CONSTRAINT_CONDITION = "constraint_condition"  # output or monitor: condition of the constraints
SINGULAR_CONDITION = 1e3  # condition from which a configuration is singular


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class Invariant:
    """Residuals of constraints that the equations hold only through their derivatives.

    Attributes:
        states: Positions in `Dae.x` of what a projection may move.
        residual: Of time, states, inputs and parameters, (m, 1), m up to the number of those
            states.
        sizes: What counts as an equally large move of each of those states, positive; of the same
            symbols.
        meaning: What is true while it is zero.
    """

    states: tuple[int, ...]
    residual: SX
    sizes: SX
    meaning: str


@dataclass(frozen=True, eq=False)
class Closing:
    """How algebraic equations make drift decay (Baumgarte, 1972).

    Attributes:
        rate: Double root of the decay, 1/s; 0 where nothing is done.
        symbol: What stands for the rate.
        residual: The algebraic equations as a function of it, too, (nz, 1).
    """

    rate: float
    symbol: SX
    residual: SX
