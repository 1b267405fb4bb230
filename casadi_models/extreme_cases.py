"""The catalogue of extreme cases: every model where its numbers or its physics become extreme.

A case names a run and the reference that measures its error. Tolerances are 1e-8 except in the
family "tolerances". Errors are relative to the larger of a variable's nominal value and its
largest value.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from math import nan, pi

from casadi_models.units import DEGREE, FOOT_POUND

# Largest relative errors that are accurate at the default tolerance of 1e-8. A fixed step has no
# tolerance: its bound matches `integrate.validity.STEP_DOUBT`.
ADAPTIVE, FIXED_STEP = 1e-3, 2e-2


@dataclass(frozen=True)
class Counterpart:
    """A run with the same solution: a second formulation or solver, at a tighter tolerance."""

    model: str
    solver: str
    relative_tolerance: float = 1e-11


@dataclass(frozen=True)
class Case:
    """One run with extreme values.

    Attributes:
        family: The quantity that is extreme, e.g. "crank: spin".
        name: The value of that quantity.
        model: `MODEL/FORMULATION`.
        values: Parameters and initial values, SI.
        stop_time: End of the run, s.
        bound: Largest relative error that counts as accurate.
        oracle: Name in `cosim.study.extremes.oracles.ORACLES` of the function that measures it.
        references: Runs for the oracle "reference"; the first one that succeeds is used.
        solver, relative_tolerance, step_size: See `simulate`.
        points: Number of output intervals.
        long: Whether the case takes minutes; long cases run only if they are requested.
    """

    family: str
    name: str
    model: str
    values: Mapping[str, float] = field(default_factory=dict)
    stop_time: float = 1.0
    bound: float = ADAPTIVE
    oracle: str = "reference"
    references: tuple[Counterpart, ...] = ()
    solver: str | None = None
    relative_tolerance: float = 1e-8
    step_size: float | None = None
    points: int = 100
    long: bool = False


CRANK = ("crank_shaft/driven", "crank_shaft/multipliers")
BAR = ("bar_on_frame/reduced", "bar_on_frame/two_body")
BICYCLE = ("bicycle/independent", "bicycle/book", "bicycle/multipliers")
DISK = ("disk_two_bars/reduced", "disk_two_bars/multipliers")
PENDULUM = tuple(
    f"double_pendulum/{form}"
    for form in ("quaternion", "euler_313", "euler_313_axial", "multipliers")
)
FIXED_STEPS = ("rk4", "ode8")
EXPLICIT = ("cvodes", "erk", "rosenbrock", "dop853", *FIXED_STEPS)
IMPLICIT = ("idas", "rosenbrock")
SINGULAR = ("cvodes", "erk", "dop853", "rk4", "ode8")  # solvers for singular configurations
FACTORS = (1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9)


def _other(model: str, solver: str, usual: str, tolerance: float = 1e-11) -> Counterpart:
    """Return a run by the usual solver, or by rosenbrock if that is the solver of the case."""
    return Counterpart(model, "rosenbrock" if solver == usual else usual, tolerance)


def catalogue() -> Iterator[Case]:
    """Yield every case."""
    for family in (
        _crank_cases,
        _bar_cases,
        _bicycle_cases,
        _disk_cases,
        _pendulum_cases,
        _masses,
        _tolerances,
        _hours,
    ):
        for case in family():
            fixed = case.oracle == "reference" and case.solver in FIXED_STEPS
            yield replace(case, bound=FIXED_STEP) if fixed else case


def _crank_cases() -> Iterator[Case]:
    for model, power in product(CRANK, range(-6, 7)):
        values = {"omega": 10.0**power}
        yield Case(
            "crank: spin", f"omega = 1e{power} rad/s", model, values, 4.0, 1e-6, oracle="crank"
        )
    for solver in (*EXPLICIT, "idas", "cvodes_adams"):
        values = {"omega": 1e6}
        name = f"1e6 rad/s, {solver}"
        yield Case("crank: spin", name, CRANK[0], values, 4.0, 1e-6, "crank", solver=solver)
    for model in CRANK:
        values = {"alpha": 0.0, "omega": 50.0}
        name, span = "1e6 revolutions at 50 rad/s", 2e6 * pi / 50
        yield Case("crank: spin", name, model, values, span, 1e-6, "crank")
    for model, factor in product(CRANK, FACTORS):
        values = {"density": 7861.1 * factor}
        yield Case("crank: mass", f"density x {factor:g}", model, values, 4.0, 1e-6, "crank")


def _bar_cases() -> Iterator[Case]:
    runs = [(BAR[0], solver) for solver in (*EXPLICIT, "cvodes_adams")]
    runs += [(BAR[1], solver) for solver in (*IMPLICIT, "dop853")]
    for b, (model, solver) in product((0, 2e-4, 2e-2, 0.2, 2, 20, 200, 2000), runs):
        other = Counterpart(BAR[0], "cvodes" if solver == "rosenbrock" else "rosenbrock")
        yield Case(
            "bar: damping",
            f"b = {b:g} ft.lbf.s/rad, {solver}",
            model,
            {"b": b * FOOT_POUND},
            10.0,
            references=(other,),
            solver=solver,
            step_size=0.01 if solver in FIXED_STEPS else None,
        )
    for theta, (model, solver) in product((0.0, pi / 2, pi), runs):
        values = {"theta": theta, "theta_dot": 0.0, "Omega_dot": 0.0}
        name = f"theta = {theta / DEGREE:g} deg, {solver}"
        # pi/2 is unstable: rounding grows by exp(Omega t), to 1e-10 in 2 s
        yield Case("bar: equilibrium", name, model, values, 2.0, 1e-7, "at_rest", solver=solver)
    for Omega, (model, solver) in product((0, 1e-3, 0.1, 1, 10, 100, 1e3, 1e4), runs):
        yield Case(
            "bar: frame rate",
            f"Omega = {Omega:g} rad/s, {solver}",
            model,
            {"Omega": Omega},
            min(10.0, 100 / max(Omega, 1)),
            references=(_other(BAR[0], solver, "erk"),),
            solver=solver,
        )


def _bicycle_cases() -> Iterator[Case]:
    runs = [(BICYCLE[0], solver) for solver in EXPLICIT]
    runs += [(BICYCLE[1], "cvodes"), *((BICYCLE[2], name) for name in (*IMPLICIT, "dop853"))]
    speeds = (0.0, 0.01, 2.0, 3.5, 4.292, 6.024, 8.0, 30.0, 100.0)
    for speed, (model, solver) in product(speeds, runs):
        values = {"thetaR_dot": -speed / 0.3, "phi_dot": 0.01}
        name, other = f"speed = {speed:g} m/s, {solver}", _other(BICYCLE[0], solver, "erk")
        case = Case("bicycle: speed", name, model, values, 2.0, solver=solver)
        yield replace(case, references=(other,))
    for speed, model in product(speeds, BICYCLE):
        values = {"thetaR_dot": -speed / 0.3, "phi_dot": 0.0}
        name = f"speed = {speed:g} m/s"
        yield Case("bicycle: exactly upright", name, model, values, 20.0, 1e-6, "upright")
    others = (
        Counterpart(BICYCLE[2], "rosenbrock"),
        Counterpart(BICYCLE[0], "erk"),
        Counterpart(BICYCLE[2], "idas", 1e-10),
    )
    for lean, model in product((60, 75, 85, 89, 89.99, 90), BICYCLE):
        values = {"phi": lean * DEGREE, "phi_dot": 0.0, "thetaR_dot": -10.0}
        case = Case("bicycle: near fall", f"lean {lean:g} deg", model, values, 0.3)
        yield replace(case, references=others)
    steered = {"phi_dot": 0.0, "delta": 85 * DEGREE, "delta_dot": 1.0, "thetaR_dot": -3.0}
    for (model, solver), stop in product(runs, (0.02, 0.1, 0.2)):
        name = f"stop time = {stop:g} s, {solver}"
        case = Case("bicycle: steered through 92 deg", name, model, steered, stop)
        other = Counterpart(BICYCLE[2], "idas" if solver == "rosenbrock" else "rosenbrock", 1e-10)
        yield replace(case, solver=solver, references=(other,))
    for model, rtol in product(BICYCLE, (1e-6, 1e-8, 1e-10)):
        values = {"thetaR_dot": -4.0 / 0.3, "phi_dot": 0.2}
        case = Case("bicycle: weave of 200 s", f"rtol {rtol:g}", model, values, 200.0, 1e-3)
        yield replace(case, oracle="bicycle", relative_tolerance=rtol, points=2000)


def _disk_cases() -> Iterator[Case]:
    runs = [(DISK[0], "cvodes"), (DISK[0], "ode8"), *((DISK[1], solver) for solver in IMPLICIT)]
    nominal = {"k1": 50, "k2": 5, "c1": 4, "c2": 0.4}
    for letter, factor in product("kc", (0, 1e-6, 1e-3, 1, 1e3, 1e6)):
        values = {n: v * FOOT_POUND * factor for n, v in nominal.items() if n[0] == letter}
        for model, solver in runs:
            name = f"{letter} x {factor:g}, {solver}"
            case = Case("disk: springs and dampers", name, model, values, 2.0, solver=solver)
            other = "cvodes" if solver == "rosenbrock" else "rosenbrock"
            # With a stiff spring, the absolute tolerance of the angles limits the torque
            bound = 1e-2 if factor > 1 else ADAPTIVE
            yield replace(case, bound=bound, references=(Counterpart(DISK[0], other),))


def _pendulum_cases() -> Iterator[Case]:
    regular = Counterpart(PENDULUM[0], "erk", 1e-12)
    for angle, solver in product((0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, pi), SINGULAR):
        values = {"theta1_0": angle}
        name = f"theta1 = {angle:g} rad, {solver}"
        case = Case("pendulum: 3-1-3 singularity", name, PENDULUM[2], values, 2.0)
        yield replace(case, solver=solver, references=(regular,))
    for height, solver in product((80, 89, 89.999, 90), SINGULAR):
        values = {"theta1_0": height * DEGREE, "phi1_0": 0.0}
        name = f"link 1 at {height:g} deg, {solver}"
        case = Case("pendulum: 3-1-3 singularity", name, PENDULUM[1], values, 2.0)
        yield replace(case, solver=solver, references=(regular,))
    for model, power in product(PENDULUM, range(5)):
        values = {"w1_z0": 10.0**power, "w2_z0": -(10.0**power)}
        span = 1.0 if power < 4 else 0.1
        case = Case("pendulum: spin", f"spin = 1e{power} rad/s", model, values, span)
        yield replace(case, references=(replace(regular, solver="rosenbrock"),))
    for model, power in product(PENDULUM, range(-6, 0)):
        values = {"diameter": 10.0**power}
        case = Case("pendulum: diameter", f"diameter = 1e{power} m", model, values, 2.0)
        yield replace(case, references=(regular,))
    for model, rate in product(PENDULUM, (5.0, 10.0, 20.0, 50.0, 200.0)):
        values = {"w1_x0": rate, "w2_x0": rate}
        case = Case("pendulum: thrown over the top", f"rate = {rate:g} rad/s", model, values, 1.0)
        yield replace(case, references=(regular,))


def _masses() -> Iterator[Case]:
    changed = (
        (BAR, "column_mass", 0.15, "erk"),
        (BAR, "m", 2.9, "rosenbrock"),
        (DISK, "disk_mass", 2.9, "rosenbrock"),
        (DISK, "bar_mass", 1.46, "rosenbrock"),
        (PENDULUM, "m", 2.8, "erk"),
        (BICYCLE, "mB", 85.0, "rosenbrock"),
        (BICYCLE, "mC", 4.0, "rosenbrock"),
    )
    for models, name, number, solver in changed:
        references = (Counterpart(models[0], solver), Counterpart(models[0], "erk"))
        for model, factor in product(models, FACTORS):
            values = {name: number * factor}
            case = Case("mass ratios", f"{name} x {factor:g}", model, values, 1.0)
            yield replace(case, references=references)


def _tolerances() -> Iterator[Case]:
    values = (nan, -1.0, 0.0, 1e-18, 1e-15, 1e-14, 1e-13, 1e-12, 1e-11, 1e-9, 1e-4, 1e-2, 0.1, 1.0)
    solvers = ("cvodes", "cvodes_adams", "erk", "dop853", "rosenbrock", "idas")
    for rtol, solver in product(values, solvers):
        other = _other(PENDULUM[0], solver, "erk", 1e-13)
        case = Case("tolerances", f"rtol {rtol:g}, {solver}", PENDULUM[0], {}, 2.0)
        bound = max(1e-7, 20 * rtol) if rtol == rtol else 1e-7
        yield replace(
            case, bound=bound, solver=solver, relative_tolerance=rtol, references=(other,)
        )
    for rtol, solver in product((1e-14, 1e-13, 1e-12, 1e-11), (*IMPLICIT, "dop853")):
        case = Case("tolerances", f"rtol {rtol:g}, {solver}", PENDULUM[3], {}, 2.0)
        other = Counterpart(PENDULUM[0], "erk", 1e-13)
        yield replace(case, solver=solver, relative_tolerance=rtol, references=(other,))


def _hours() -> Iterator[Case]:
    kinds: tuple[tuple[tuple[str, ...], str, dict[str, float], str], ...] = (
        (PENDULUM, "free", {}, "energy"),
        (BAR, "undamped, constant rate", {"b": 0.0, "Omega_dot": 0.0}, "jacobi"),
        (BICYCLE, "weave at 4 m/s", {"thetaR_dot": -4.0 / 0.3, "phi_dot": 0.2}, "bicycle"),
        (DISK, "undamped", {"c1": 0.0, "c2": 0.0}, "power"),
        (CRANK, "constant rate", {"alpha": 0.0}, "crank"),
    )
    for models, name, values, oracle in kinds:
        for model in models:
            case = Case("an hour", name, model, values, 3600.0, 1e-2, oracle)
            yield replace(case, points=360_000 if oracle == "power" else 3600, long=True)
