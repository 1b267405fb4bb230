"""The mechanics kernel on its own: closed forms, and identities between its formulations."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX, cos, sin
from helpers.support import value

from casadi_models.mechanics import kane, rotations

RNG = np.random.default_rng(1)
ROUNDING = 1e-13  # relative to the largest entry; measured 4e-15 over 200 states
E1, E2, E3 = (rotations.unit(axis) for axis in (1, 2, 3))


def assert_equal(actual, expected, *pairs, states=20, tolerance=ROUNDING):
    """Compare two expressions at seeded random values of the symbols in `pairs` (symbol, range)."""
    for _ in range(states):
        at = [(s, RNG.uniform(low, high, s.shape)) for s, (low, high) in pairs]
        a, b = value(ca.vec(SX(actual)), *at), value(ca.vec(SX(expected)), *at)
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance * max(1, np.abs(b).max()))


def solved(equations, unknowns):
    """Return the solution of equations that are linear in the unknowns."""
    matrix = ca.jacobian(equations, unknowns)
    return -ca.solve(matrix, ca.substitute(equations, unknowns, SX.zeros(unknowns.shape)))


# -- closed forms ---------------------------------------------------------------------------------


def test_simple_pendulum_swings_and_pulls_its_string():
    theta, theta_dot, stretch = SX.sym("theta"), SX.sym("theta_dot"), SX.sym("stretch")
    m, length, g = 2.0, 0.7, 9.81
    velocity = ca.vertcat(stretch, length * theta_dot)  # along the string, across it
    velocity, turning = ca.vertcat(velocity, 0), theta_dot * E3
    weight = m * g * ca.vertcat(cos(theta), -sin(theta), 0)
    system = kane.System(
        q=theta,
        q_dot=theta_dot,
        free=theta_dot,
        held=stretch,
        inertias=(kane.InertialTerm(velocity, m * velocity, turning),),
        loads=(kane.Load(velocity, weight),),
    )
    theta_ddot = kane.accelerations(system).free
    ranges = (theta, (-3, 3)), (theta_dot, (-5, 5))
    assert_equal(theta_ddot, -g / length * sin(theta), *ranges)
    string = -m * (length * theta_dot**2 + g * cos(theta))  # pulls inward
    assert_equal(kane.reactions(system, theta_ddot), string, *ranges)


def test_heavy_top_precesses_steadily():
    angles, rates = SX.sym("angles", 3), SX.sym("rates", 3)  # precession, nutation, spin
    a, c, m, g, height = 0.3, 0.1, 1.5, 9.81, 0.4
    rotation, omega = rotations.body_fixed((3, 1, 3), angles, rates)
    velocity = ca.cross(omega, height * E3)
    system = kane.System(
        q=angles,
        q_dot=rates,
        free=rates,
        inertias=kane.body(m, np.diag([a - m * height**2, a - m * height**2, c]), velocity, omega),
        loads=(kane.Load(velocity, rotation.T @ (-m * g * E3)),),
    )
    precession, nutation = SX.sym("precession"), SX.sym("nutation")
    # m g h = (C w3 - A p cos(nutation)) p, with w3 the total spin (Goldstein, 5.7)
    total = (m * g * height + a * precession**2 * cos(nutation)) / (c * precession)
    steady = ca.vertcat(precession, 0, total - precession * cos(nutation))
    accelerations = ca.substitute(kane.accelerations(system).free, rates, steady)
    accelerations = ca.substitute(accelerations, angles[1], nutation)
    ranges = (
        (precession, (0.5, 3)),
        (nutation, (0.3, 2)),
        (ca.vertcat(angles[0], angles[2]), (0, 6)),
    )
    assert_equal(accelerations, SX.zeros(3), *ranges, tolerance=1e-12)  # measured 2e-14


def test_bead_on_a_turning_hoop_and_the_torque_that_turns_it():
    theta, theta_dot = SX.sym("theta"), SX.sym("theta_dot")
    Omega, Omega_dot = SX.sym("Omega"), SX.sym("Omega_dot")
    m, r, g = 0.5, 1.2, 9.81
    # radial, along the hoop, across its plane; the frame turns with the bead
    velocity = ca.vertcat(0, r * theta_dot, -r * sin(theta) * Omega)
    turning = ca.vertcat(-cos(theta) * Omega, sin(theta) * Omega, theta_dot)
    weight = m * g * ca.vertcat(cos(theta), -sin(theta), 0)
    system = kane.System(
        q=theta,
        q_dot=theta_dot,
        free=theta_dot,
        prescribed=Omega,
        prescribed_dot=Omega_dot,
        inertias=(kane.InertialTerm(velocity, m * velocity, turning),),
        loads=(kane.Load(velocity, weight),),
    )
    theta_ddot = kane.accelerations(system).free
    ranges = [(symbol, (-3, 3)) for symbol in (theta, theta_dot, Omega, Omega_dot)]
    assert_equal(theta_ddot, Omega**2 * sin(theta) * cos(theta) - g / r * sin(theta), *ranges)
    about_axis = m * r**2 * sin(theta) ** 2 * Omega  # angular momentum; its rate is the torque
    torque = ca.jtimes(about_axis, ca.vertcat(theta, Omega), ca.vertcat(theta_dot, Omega_dot))
    assert_equal(kane.reactions(system, theta_ddot), torque, *ranges)


def test_body_on_a_driven_fixed_axis_loads_its_bearing_as_euler_says():
    phi, omega, alpha = SX.sym("phi"), SX.sym("omega"), SX.sym("alpha")
    held = SX.sym("held", 5)  # velocity of a point O on the axis, rates across the axis
    m, offset = 3.0, np.array([0.2, -0.1, 0.5])  # from O to G
    inertia = np.array([[0.5, 0.03, -0.04], [0.03, 0.6, 0.05], [-0.04, 0.05, 0.4]])
    rate = ca.vertcat(held[3], held[4], omega)
    velocity = held[:3] + ca.cross(rate, SX(offset))
    system = kane.System(
        q=phi,
        q_dot=omega,
        free=SX(0, 1),
        prescribed=omega,
        prescribed_dot=alpha,
        held=held,
        inertias=kane.body(m, inertia, velocity, rate),
    )
    for w, a in RNG.uniform(-4, 4, (20, 2)):
        spin, gain = np.array([0, 0, w]), np.array([0, 0, a])
        force = m * (np.cross(gain, offset) + np.cross(spin, np.cross(spin, offset)))
        about_g = inertia @ gain + np.cross(spin, inertia @ spin)
        moment = about_g + np.cross(offset, force)
        loads = value(kane.reactions(system, SX(0, 1)), (omega, w), (alpha, a)).ravel()
        np.testing.assert_allclose(loads[[4, 5, 0]], moment, rtol=0, atol=1e-13)  # measured 2e-14
        np.testing.assert_allclose(loads[1:4], force, rtol=0, atol=1e-13)


def test_pendulum_on_a_shaken_pivot_has_time_as_a_coordinate():
    theta, theta_dot, t = SX.sym("theta"), SX.sym("theta_dot"), SX.sym("t")
    m, length, g, amplitude, frequency = 0.8, 0.5, 9.81, 0.05, 30.0
    height = amplitude * cos(frequency * t) - length * cos(theta)
    place = ca.vertcat(length * sin(theta), height, 0)
    q, q_dot = ca.vertcat(theta, t), ca.vertcat(theta_dot, 1)
    velocity = ca.jtimes(place, q, q_dot)  # not resolved in the turning frame
    system = kane.System(
        q=q,
        q_dot=q_dot,
        free=theta_dot,
        inertias=(kane.InertialTerm(velocity, m * velocity),),
        loads=(kane.Load(velocity, -m * g * E2),),
    )
    lift = -amplitude * frequency**2 * cos(frequency * t)
    expected = -(g + lift) / length * sin(theta)
    ranges = (theta, (-3, 3)), (theta_dot, (-5, 5)), (t, (0, 1))
    assert_equal(kane.accelerations(system).free, expected, *ranges)


# -- a ball that rolls on a driven turntable: constraints that hold a prescribed speed ------------


def ball_on_turntable():
    """Declare a solid ball that rolls on a table whose rate Omega about Z is given."""
    m, r = 0.3, 0.05
    place, omega, velocity = SX.sym("place", 2), SX.sym("omega", 3), SX.sym("velocity", 3)
    Omega, Omega_dot = SX.sym("Omega"), SX.sym("Omega_dot")
    at_contact = velocity + ca.cross(omega, -r * E3)
    table = ca.cross(Omega * E3, ca.vertcat(place, 0))
    parts = {
        "q": place,
        "q_dot": velocity[:2],
        "prescribed": Omega,
        "prescribed_dot": Omega_dot,
        "inertias": (
            kane.InertialTerm(velocity, m * velocity),
            kane.InertialTerm(omega, 0.4 * m * r**2 * omega),
        ),
        "loads": (kane.Load(velocity, -m * 9.81 * E3),),
        "constraints": at_contact - table,
    }
    symbols = (place, omega, velocity, Omega, Omega_dot)
    return parts, symbols, m


def test_ball_on_a_turntable_circles_at_two_sevenths_of_its_rate():
    parts, (place, omega, velocity, Omega, Omega_dot), m = ball_on_turntable()
    system = kane.System(free=omega, dependent=velocity, **parts)
    found = kane.accelerations(system)
    expected = (
        2 / 7 * (Omega * ca.cross(E3, velocity) + Omega_dot * ca.cross(E3, ca.vertcat(place, 0)))
    )
    ranges = [(s, (-2, 2)) for s in (place, omega, velocity[:2], Omega, Omega_dot)]
    level = ca.vertcat(velocity[:2], 0)
    assert_equal(found.dependent, ca.substitute(expected, velocity, level), *ranges)
    contact = kane.constraint_loads(system, found.unknown)  # of the table on the ball
    assert_equal(contact, m * (found.dependent + 9.81 * E3), *ranges)
    torque = kane.reactions(system, found.unknown, contact)  # turns a table without inertia
    assert_equal(torque, ca.cross(ca.vertcat(place, 0), contact)[2], *ranges)


def test_multipliers_give_what_elimination_gives():
    parts, (place, omega, velocity, Omega, Omega_dot), _ = ball_on_turntable()
    eliminated = kane.System(free=omega, dependent=velocity, **parts)
    kept = kane.System(free=ca.vertcat(omega, velocity), **parts)
    rates, loads = SX.sym("rates", 6), SX.sym("loads", 3)
    equations = kane.multiplier_equations(kept, rates, loads)
    unknowns = ca.vertcat(rates, loads)
    accelerations = kane.accelerations(eliminated)
    contact = kane.constraint_loads(eliminated, accelerations.unknown)
    ranges = [(s, (-2, 2)) for s in (place, omega, velocity, Omega, Omega_dot)]
    solution = solved(equations, unknowns)
    expected = ca.vertcat(accelerations.unknown, contact)
    assert_equal(solution, expected, *ranges, tolerance=1e-12)  # measured 2e-13
    torques = [
        kane.reactions(eliminated, accelerations.unknown, contact),
        kane.reactions(kept, solution[:6], solution[6:]),
    ]
    assert_equal(*torques, *ranges, tolerance=1e-12)


def test_eliminated_accelerations_keep_the_constraints():
    parts, symbols, _ = ball_on_turntable()
    system = kane.System(free=symbols[1], dependent=symbols[2], **parts)
    found = kane.accelerations(system)
    residual = kane.constraint_acceleration(system, found.unknown)
    assert_equal(residual, SX.zeros(3), *[(symbol, (-2, 2)) for symbol in symbols])


def test_speed_relation_is_the_constraint_solved_for_the_dependent_speeds():
    parts, (place, omega, velocity, Omega, _), _ = ball_on_turntable()
    system = kane.System(free=omega, dependent=velocity, **parts)
    rolling = ca.substitute(parts["constraints"], Omega, 0)  # on a table at rest
    moved = ca.substitute(rolling, velocity, ca.densify(kane.speed_relation(system) @ omega))
    assert_equal(moved, SX.zeros(3), (place, (-2, 2)), (omega, (-2, 2)))


# -- power ----------------------------------------------------------------------------------------


def test_kinetic_energy_grows_by_the_power_of_loads_and_drive():
    parts, (place, omega, velocity, Omega, Omega_dot), _ = ball_on_turntable()
    system = kane.System(free=omega, dependent=velocity, **parts)
    found = kane.accelerations(system)
    on_table = ca.cross(omega, 0.05 * E3) + ca.cross(Omega * E3, ca.vertcat(place, 0))
    growth = system.time_derivative(kane.kinetic_energy(system), found.unknown)
    contact = kane.constraint_loads(system, found.unknown)
    drive = kane.reactions(system, found.unknown, contact) * Omega
    power = ca.dot(velocity, -0.3 * 9.81 * E3) + drive
    growth, power = (ca.substitute(e, velocity, on_table) for e in (growth, power))
    assert_equal(growth, power, *[(s, (-2, 2)) for s in (place, omega, Omega, Omega_dot)])


# -- frames ---------------------------------------------------------------------------------------


def top(resolved_in):
    """Declare an axisymmetric body under a load, its terms resolved in one of four frames."""
    m, inertia = 1.3, SX(np.diag([0.3, 0.3, 0.1]))
    angles, u = SX.sym("angles", 3), SX.sym("u", 6)  # velocity and rate in body axes
    velocity, omega = u[:3], u[3:]
    rotation, _ = rotations.body_fixed((3, 1, 3), angles, SX.zeros(3))
    rates = SX.sym("rates", 3)
    _, omega_of = rotations.body_fixed((3, 1, 3), angles, rates)
    q_dot = ca.solve(ca.jacobian(omega_of, rates), omega)
    pull = ca.vertcat(1.0, -2.0, 0.5)  # N, in world axes
    if resolved_in == "body":
        inertias = kane.body(m, inertia, velocity, omega)
    elif resolved_in == "world":
        inertias = kane.body(
            m, rotation @ inertia @ rotation.T, rotation @ velocity, rotation @ omega, SX.zeros(3)
        )
    elif resolved_in == "spun with the angles":  # a body-fixed frame other than the main axes
        turn = rotations.about(1, 0.4) @ rotations.about(2, -1.1)
        inertias = kane.body(m, turn @ inertia @ turn.T, turn @ velocity, turn @ omega)
    else:  # does not take part in the spin, where the inertia looks the same
        turn = rotations.about(3, angles[2])
        carried = turn @ omega - q_dot[2] * E3
        inertias = kane.body(m, inertia, turn @ velocity, turn @ omega, carried)
    system = kane.System(
        q=angles,
        q_dot=q_dot,
        free=u,
        inertias=inertias,
        loads=(kane.Load(velocity, rotation.T @ pull), kane.Load(omega, SX([0.1, 0.2, -0.3]))),
    )
    return kane.accelerations(system).free, angles, u


@pytest.mark.parametrize("frame", ["world", "spun with the angles", "without spin"])
def test_accelerations_do_not_depend_on_the_frame_of_the_momenta(frame):
    expected, angles, u = top("body")
    found, *symbols = top(frame)
    found = ca.substitute(found, ca.vertcat(*symbols), ca.vertcat(angles, u))
    nutation = (angles[1], (0.3, 2.8))  # away from the singular angles
    ranges = nutation, (ca.vertcat(angles[0], angles[2]), (-3, 3)), (u, (-2, 2))
    assert_equal(found, expected, *ranges)


def test_gyrostat_is_body_and_rotor_as_two_bodies():
    m_body, m_rotor, axial, across = 2.0, 0.7, 0.05, 0.03
    axis, center = np.array([0.6, 0.0, 0.8]), np.array([0.3, -0.2, 0.1])  # rotor, in body axes
    own = np.array([[0.5, 0.02, -0.03], [0.02, 0.6, 0.01], [-0.03, 0.01, 0.4]])
    rotor = across * np.eye(3) + (axial - across) * np.outer(axis, axis)
    velocity, omega, spin = SX.sym("velocity", 3), SX.sym("omega", 3), SX.sym("spin")
    loads = (kane.Load(omega, SX([0.1, -0.2, 0.3])), kane.Load(spin, SX(0.05)))
    loads += (kane.Load(velocity, SX([1.0, 2.0, -1.0])),)
    parts = {"q": SX(0, 1), "q_dot": SX(0, 1), "free": ca.vertcat(velocity, omega, spin)}

    mass = m_body + m_rotor
    to_body, to_rotor = -m_rotor / mass * center, m_body / mass * center  # from the common center
    locked = own + rotor
    for m, r in ((m_body, to_body), (m_rotor, to_rotor)):
        locked = locked + m * (r @ r * np.eye(3) - np.outer(r, r))
    merged = kane.gyrostat(mass, locked, velocity, omega, axial, SX(axis), spin)
    # the rotor's momenta stand in the frame of the body, which does not spin
    parted = (
        *kane.body(m_body, own, velocity + ca.cross(omega, SX(to_body)), omega),
        *kane.body(
            m_rotor, rotor, velocity + ca.cross(omega, SX(to_rotor)), omega + spin * axis, omega
        ),
    )
    found, expected = (
        kane.accelerations(kane.System(inertias=terms, loads=loads, **parts)).free
        for terms in (merged, parted)
    )
    ranges = [(symbol, (-3, 3)) for symbol in (velocity, omega, spin)]
    assert_equal(found, expected, *ranges)
    energies = [kane.kinetic_energy(kane.System(inertias=i, **parts)) for i in (merged, parted)]
    assert_equal(*energies, *ranges)


# -- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"q_dot": SX.zeros(3)}, r"q has shape \(2, 1\), q_dot has \(3, 1\)"),
        ({"prescribed_dot": SX(0, 1)}, r"prescribed has shape \(1, 1\), prescribed_dot has"),
        ({"dependent": SX.sym("v", 2)}, r"dependent has shape \(2, 1\), constraints has \(3, 1\)"),
    ],
)
def test_columns_that_belong_together_must_have_one_length(change, reason):
    parts, (_, omega, velocity, *_), _ = ball_on_turntable()
    with pytest.raises(ValueError, match=reason):
        kane.System(**({"free": omega, "dependent": velocity} | parts | change))


def test_constraints_are_never_left_out_silently():
    parts, (_, omega, velocity, *_), _ = ball_on_turntable()
    kept = kane.System(free=ca.vertcat(omega, velocity), **parts)
    with pytest.raises(ValueError, match="constraints without dependent speeds"):
        kane.accelerations(kept)
    with pytest.raises(ValueError, match="the loads of the constraints are missing"):
        kane.reactions(kept, SX.zeros(6))
    eliminated = kane.System(free=omega, dependent=velocity, **parts)
    with pytest.raises(ValueError, match="declare all of them free"):
        kane.multiplier_equations(eliminated, SX.zeros(3), SX.zeros(3))
