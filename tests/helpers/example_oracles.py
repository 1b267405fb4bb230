"""Final values of the examples: published numbers, closed forms, independent equations."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

Values = dict[str, float]
G = 9.81


def _numbered(name: str, values: list[float]) -> Values:
    return {f"{name}_{i}": value for i, value in enumerate(values, start=1)}


def _integrated(slope, start: list[float], stop: float) -> np.ndarray:
    found = solve_ivp(slope, (0, stop), start, "DOP853", rtol=1e-13, atol=1e-13)
    return found.y[:, -1]


def andrews() -> Values:
    """Test Set for IVP Solvers, 2008, ANDREWS, t = 0.03."""
    return _numbered(
        "q",
        [
            0.1581077119629904e2,
            -0.1575637105984298e2,
            0.4082224013073101e-1,
            -0.5347301163226948,
            0.5244099658805304,
            0.5347301163226948,
            0.1048080741042263e1,
        ],
    )


def car_axis() -> Values:
    """Test Set for IVP Solvers, 2008, CARAX, t = 3."""
    places = [
        0.493455784275402809e-1,
        0.496989460230171154,
        1.04174252488542152,
        0.373911027265361257,
    ]
    rates = [
        -0.770583684040972358e-1,
        0.744686658723778553e-2,
        0.175568157537232222e-1,
        0.770341043779251976,
    ]
    return _numbered("q", places) | _numbered("v", rates)


def robertson() -> Values:
    """Hindmarsh, ODEPACK; Test Set, ROBER: t = 40."""
    return {"y_1": 0.7158270687, "y_2": 0.9185534764e-5, "y_3": 0.2841637457}


def robertson_late() -> Values:
    """Test Set for IVP Solvers, 2008, ROBER, t = 1e11."""
    return {"y_1": 0.2083340149701255e-7, "y_2": 0.8333360770334713e-13, "y_3": 0.9999999791665050}


def hires() -> Values:
    """Test Set for IVP Solvers, 2008, HIRES, t = 321.8122."""
    return _numbered(
        "y",
        [
            0.7371312573325668e-3,
            0.1442485726316185e-3,
            0.5888729740967575e-4,
            0.1175651343283149e-2,
            0.2386356198831331e-2,
            0.6238968252742796e-2,
            0.2849998395185769e-2,
            0.2850001604814231e-2,
        ],
    )


def van_der_pol() -> Values:
    """Test Set for IVP Solvers, 2008, VDPOL, t = 2."""
    return {"y": 0.1706167732170483e1, "v": -0.8928097010247975}


def heat() -> Values:
    """Slowest mode of the discrete rod, t = 0.1."""
    h = 1 / 201
    decay = np.exp(-0.1 * (2 / h * np.sin(np.pi * h / 2)) ** 2)
    return {f"T_{i}": np.sin(np.pi * h * i) * decay for i in (1, 50, 100)}


def pendulum_a01() -> Values:
    """Jacobi's elliptic functions: amplitude 90 deg, t = 10."""
    m = 0.5
    _, cn, dn, _ = ellipj(np.sqrt(G) * 10.0, m)
    angle = 2 * np.arcsin(np.sqrt(m) * cn / dn)
    assert ellipk(m) > 0
    return {"x": -np.sin(angle), "y": -np.cos(angle)}


def four_bars_a02() -> Values:
    """All cranks turn alike: one equation for their angle from the vertical, t = 10."""
    n = 2
    growth = G * ((n + 1) / 2 + n) / ((n + 1) / 3 + n)
    angle, rate = _integrated(lambda t, y: [y[1], growth * np.sin(y[0])], [0.0, 1.0], 10.0)
    tops = {f"x{i}": i + np.sin(angle) for i in range(n + 1)}
    return tops | {"y0": np.cos(angle), "x0_dot": np.cos(angle) * rate}


def slider_crank_3d() -> Values:
    """One equation for the crank, with the inertia that it feels; t = 2."""
    crank, rod, inertia, mass, slider = 0.08, 0.3, 1e-4, 0.5, 2.0

    def place(a):
        y, z = 0.1 - crank * np.sin(a), 0.12 + crank * np.cos(a)
        s = np.sqrt(rod**2 - y**2 - z**2)
        return s, crank * (y * np.cos(a) + z * np.sin(a)) / s

    def felt(a):
        return inertia + (slider + mass / 3) * place(a)[1] ** 2 + mass / 3 * crank**2

    def slope(t, y):
        growth = felt(y[0] + 1e-30j).imag / 1e-30  # complex step
        torque = mass * G / 2 * crank * np.sin(y[0])
        return [y[1], (torque - growth * y[1] ** 2 / 2) / felt(y[0])]

    angle, rate = _integrated(slope, [0.0, 6.0], 2.0)
    return {"theta": angle, "theta_dot": rate, "s": place(angle)[0]}


def heavy_top() -> Values:
    """Steady precession, t = 2."""
    tilt, turned = 1.0, 2.0 * 2.0
    axis = [np.sin(tilt) * np.sin(turned), -np.sin(tilt) * np.cos(turned), np.cos(tilt)]
    return _numbered("axis", axis)


def furuta() -> Values:
    """Lagrange's equations, written out (Cazzolato & Prime, 2011, without damping); t = 5."""
    J1, J2, m, L, l = 2.5e-2, 1.2e-3, 0.075, 0.278, 0.148  # noqa: E741
    J = J2 + m * l**2

    def slope(t, y):
        _, b, da, db = y
        s, c = np.sin(b), np.cos(b)
        mass = np.array([[J1 + m * L**2 + J * s**2, m * L * l * c], [m * L * l * c, J]])
        force = [m * L * l * s * db**2 - 2 * J * s * c * da * db, J * s * c * da**2 - m * G * l * s]
        return [da, db, *np.linalg.solve(mass, force)]

    return dict(
        zip(
            ("arm", "swing", "arm_dot", "swing_dot"),
            _integrated(slope, [0, 2.5, 0, 0], 5.0),
            strict=True,
        )
    )


def quadrotor() -> Values:
    """Lift and turn at a constant rate of change, t = 1."""
    return {
        "r_3": (5.4 / 0.5 - G) / 2,
        "yaw": 0.016 * 0.6 / 5.5e-3 / 2,
        "r_1": 0.0,
        "v_3": 5.4 / 0.5 - G,
    }


def chain() -> Values:
    """Lagrange's equations of a chain in absolute angles, in closed form; t = 1."""
    n = 8
    length = 1 / n
    below = n - 1 - np.maximum.outer(np.arange(n), np.arange(n))
    weight = length**2 * (below + np.where(np.eye(n, dtype=bool), 1 / 3, 1 / 2))
    hanging = G * length * (n - np.arange(n) - 0.5)

    def slope(t, y):
        gap = np.subtract.outer(y[:n], y[:n])
        force = -(weight * np.sin(gap)) @ y[n:] ** 2 - hanging * np.sin(y[:n])
        return [*y[n:], *np.linalg.solve(weight * np.cos(gap), force)]

    end = _integrated(slope, [np.pi / 2] * n + [0.0] * n, 1.0)
    return {f"q{i + 1}": end[i] for i in range(n)} | {f"q{i + 1}_dot": end[n + i] for i in range(n)}


ORACLES: dict[str, Callable[[], Values]] = {
    oracle.__name__: oracle
    for oracle in (
        andrews,
        car_axis,
        pendulum_a01,
        four_bars_a02,
        slider_crank_3d,
        heavy_top,
        furuta,
        quadrotor,
        robertson,
        hires,
        van_der_pol,
        heat,
        chain,
    )
}
