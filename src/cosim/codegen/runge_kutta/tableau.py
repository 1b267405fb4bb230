"""Fixed-step Runge-Kutta methods as CasADi functions: `rk4` and the 8th-order `ode8`."""

from dataclasses import dataclass
from fractions import Fraction

import casadi as ca
from casadi import MX

F = Fraction
_ROUNDED = 1e-15  # sources print fractions that are rounded to double precision


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau of an explicit method.

    Attributes:
        order: Of consistency.
        a: Weights of the earlier stages, row by row.
        b: Weights of the stages in the step.
        nodes: Where in the step each stage lies, where its source says so; the rows' sums if not.

    Raises:
        ValueError: A stage uses itself or a later one, or its weights do not add up to its node;
            or the weights of the step do not add up to 1.
    """

    order: int
    a: tuple[tuple[Fraction | int, ...], ...]
    b: tuple[Fraction | int, ...]
    nodes: tuple[Fraction | int, ...] = ()

    def __post_init__(self) -> None:
        if len(self.a) != len(self.b) or any(len(row) > i for i, row in enumerate(self.a)):
            raise ValueError(
                f"tableau of {len(self.a)} rows and {len(self.b)} weights: give a row per stage, "
                "with weights of earlier stages only"
            )
        for i, (row, node) in enumerate(zip(self.a, self.nodes, strict=True) if self.nodes else ()):
            if abs(float(sum(row) - node)) > _ROUNDED:
                raise ValueError(
                    f"tableau: weights of stage {i + 1} add up to {float(sum(row))}, its node is "
                    f"{float(node)}; a weight is wrong"
                )
        if abs(float(sum(self.b) - 1)) > _ROUNDED:
            raise ValueError(
                f"tableau: weights of the step add up to {float(sum(self.b))}, not to 1; one is "
                "wrong"
            )

    @property
    def c(self) -> tuple[float, ...]:
        """Nodes: where in the step each stage lies."""
        return tuple(float(sum(row)) for row in self.a)


RK4 = Tableau(
    4,
    ((), (F(1, 2),), (0, F(1, 2)), (0, 0, 1)),
    (F(1, 6), F(1, 3), F(1, 3), F(1, 6)),
    (0, F(1, 2), F(1, 2), 1),
)

# Prince & Dormand, High order embedded Runge-Kutta formulae, J. Comp. Appl. Math. 7 (1981):
# RK8(7)13M, the solution of order 8; MATLAB's and Simulink's ode8.
_ODE8_A = (
    (),
    (F(1, 18),),
    (F(1, 48), F(1, 16)),
    (F(1, 32), 0, F(3, 32)),
    (F(5, 16), 0, F(-75, 64), F(75, 64)),
    (F(3, 80), 0, 0, F(3, 16), F(3, 20)),
    (
        F(29443841, 614563906),
        0,
        0,
        F(77736538, 692538347),
        F(-28693883, 1125000000),
        F(23124283, 1800000000),
    ),
    (
        F(16016141, 946692911),
        0,
        0,
        F(61564180, 158732637),
        F(22789713, 633445777),
        F(545815736, 2771057229),
        F(-180193667, 1043307555),
    ),
    (
        F(39632708, 573591083),
        0,
        0,
        F(-433636366, 683701615),
        F(-421739975, 2616292301),
        F(100302831, 723423059),
        F(790204164, 839813087),
        F(800635310, 3783071287),
    ),
    (
        F(246121993, 1340847787),
        0,
        0,
        F(-37695042795, 15268766246),
        F(-309121744, 1061227803),
        F(-12992083, 490766935),
        F(6005943493, 2108947869),
        F(393006217, 1396673457),
        F(123872331, 1001029789),
    ),
    (
        F(-1028468189, 846180014),
        0,
        0,
        F(8478235783, 508512852),
        F(1311729495, 1432422823),
        F(-10304129995, 1701304382),
        F(-48777925059, 3047939560),
        F(15336726248, 1032824649),
        F(-45442868181, 3398467696),
        F(3065993473, 597172653),
    ),
    (
        F(185892177, 718116043),
        0,
        0,
        F(-3185094517, 667107341),
        F(-477755414, 1098053517),
        F(-703635378, 230739211),
        F(5731566787, 1027545527),
        F(5232866602, 850066563),
        F(-4093664535, 808688257),
        F(3962137247, 1805957418),
        F(65686358, 487910083),
    ),
    (
        F(403863854, 491063109),
        0,
        0,
        F(-5068492393, 434740067),
        F(-411421997, 543043805),
        F(652783627, 914296604),
        F(11173962825, 925320556),
        F(-13158990841, 6184727034),
        F(3936647629, 1978049680),
        F(-160528059, 685178525),
        F(248638103, 1413531060),
        0,
    ),
)
_ODE8_B = (
    F(14005451, 335480064),
    0,
    0,
    0,
    0,
    F(-59238493, 1068277825),
    F(181606767, 758867731),
    F(561292985, 797845732),
    F(-1041891430, 1371343529),
    F(760417239, 1151165299),
    F(118820643, 751138087),
    F(-528747749, 2220607170),
    F(1, 4),
)
_ODE8_NODES = (
    *(0, F(1, 18), F(1, 12), F(1, 8), F(5, 16), F(3, 8), F(59, 400), F(93, 200)),
    *(F(5490023248, 9719169821), F(13, 20), F(1201146811, 1299019798), 1, 1),
)
ODE8 = Tableau(8, _ODE8_A, _ODE8_B, _ODE8_NODES)


def step_function(rhs: ca.Function, tableau: Tableau) -> ca.Function:
    """Return `step(x, t, h, u, p) -> x_end`, one step of an explicit method.

    Args:
        rhs: `(t, x, u, p) -> dx/dt`.
        tableau: The method.
    """
    t, h = MX.sym("t"), MX.sym("h")
    x, u, p = (MX.sym(name, rhs.numel_in(i)) for i, name in ((1, "x"), (2, "u"), (3, "p")))
    slopes: list[MX] = []
    for node, row in zip(tableau.c, tableau.a, strict=True):
        slopes.append(rhs(t + node * h, x + h * _weighted(row, slopes), u, p))
    end = x + h * _weighted(tableau.b, slopes)
    return ca.Function("step", [x, t, h, u, p], [end], ["x", "t", "h", "u", "p"], ["x_end"])


def _weighted(weights: tuple[Fraction | int, ...], slopes: list[MX]) -> MX:
    total = MX(0)
    for weight, slope in zip(weights, slopes, strict=True):
        if weight:
            total = total + float(weight) * slope
    return total
