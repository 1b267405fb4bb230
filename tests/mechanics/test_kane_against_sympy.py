"""The mechanics kernel against `sympy.physics.mechanics.KanesMethod` at random states."""

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from casadi import SX
from helpers.support import value
from sympy.physics.mechanics import (
    KanesMethod,
    Point,
    ReferenceFrame,
    RigidBody,
    cross,
    dot,
    dynamicsymbols,
    inertia,
)

from casadi_models.mechanics import kane, rotations

G = 9.81


def accelerations_by_sympy(method, bodies, loads, q, u):
    """Return a function (q, u) -> accelerations, from KanesMethod's mass matrix and forcing."""
    method.kanes_equations(bodies, loads)
    q_symbols, u_symbols = sp.symbols(f"q:{len(q)}"), sp.symbols(f"u:{len(u)}")
    rates = method.kindiffdict()
    named = dict(zip([*q, *u], [*q_symbols, *u_symbols], strict=True))
    matrices = [m.xreplace(rates).xreplace(named) for m in (method.mass_matrix, method.forcing)]
    evaluate = sp.lambdify([q_symbols, u_symbols], matrices, modules="numpy", cse=True)

    def accelerations(at_q, at_u):
        mass, forcing = evaluate(at_q, at_u)
        return np.linalg.solve(mass, forcing.ravel())

    return accelerations


def vector(components, frame):
    """Return a vector from its components in the axes of a frame."""
    x, y, z = components
    return x * frame.x + y * frame.y + z * frame.z


def components(of, frame):
    return [dot(of, axis) for axis in (frame.x, frame.y, frame.z)]


# -- a disk that rolls on a plane (SymPy's classic): heading, lean, spin --------------------------
# Speeds in the axes that lean but do not spin: angular velocity, then velocity of the center,
# which depends on it.

DISK = {"m": 1.7, "r": 0.4, "moments": (1.7 * 0.4**2 / 4, 1.7 * 0.4**2 / 2, 1.7 * 0.4**2 / 4)}


def rolling_disk_by_sympy():
    q, u = dynamicsymbols("q:3"), dynamicsymbols("u:6")
    world = ReferenceFrame("N")
    heading = world.orientnew("Y", "Axis", [q[0], world.z])
    lean = heading.orientnew("L", "Axis", [q[1], heading.x])
    disk = lean.orientnew("R", "Axis", [q[2], lean.y])
    omega, velocity = vector(u[:3], lean), vector(u[3:], lean)
    kinematics = components(disk.ang_vel_in(world) - omega, lean)
    disk.set_ang_vel(world, omega)
    center = Point("C")
    center.set_vel(world, velocity)
    method = KanesMethod(
        world,
        q_ind=q,
        u_ind=u[:3],
        kd_eqs=kinematics,
        u_dependent=u[3:],
        velocity_constraints=components(velocity + cross(omega, -DISK["r"] * lean.z), lean),
    )
    tensor = inertia(lean, *DISK["moments"])
    body = RigidBody("disk", center, disk, DISK["m"], (tensor, center))
    return accelerations_by_sympy(method, [body], [(center, -DISK["m"] * G * world.z)], q, u)


def rolling_disk():
    """Return the system, and the speeds that roll in terms of the free ones."""
    angles, omega, velocity, rates = (
        SX.sym(n, 3) for n in ("angles", "omega", "velocity", "rates")
    )
    upright, leaning = rotations.body_fixed((3, 1), angles[:2], rates[:2])
    e2, e3 = rotations.unit(2), rotations.unit(3)
    q_dot = ca.solve(ca.jacobian(leaning + rates[2] * e2, rates), omega)
    carried = omega - q_dot[2] * e2
    inertias = kane.body(DISK["m"], np.diag(DISK["moments"]), velocity, omega, carried)
    system = kane.System(
        q=angles,
        q_dot=q_dot,
        free=omega,
        dependent=velocity,
        inertias=inertias,
        loads=(kane.Load(velocity, upright.T @ (-DISK["m"] * G * e3)),),
        constraints=velocity + ca.cross(omega, -DISK["r"] * e3),
    )
    return system, ca.vertcat(omega, kane.speed_relation(system) @ omega)


# -- two bodies that hang on two ball joints: body-fixed 1-2-3 turns, angular velocities ----------

LINKS = ((1.2, 0.5, (0.03, 0.05, 0.02)), (0.7, 0.3, (0.01, 0.02, 0.015)))  # mass, length, moments


def double_pendulum_by_sympy():
    q, u = dynamicsymbols("q:6"), dynamicsymbols("u:6")
    world, joint = ReferenceFrame("N"), Point("O")
    joint.set_vel(world, 0)
    parent, rate_of_parent = world, 0 * world.x
    bodies, loads, kinematics = [], [], []
    for i, (m, length, moments) in enumerate(LINKS):
        own = parent.orientnew(f"B{i}", "Body", q[3 * i : 3 * i + 3], "123")
        omega = vector(u[3 * i : 3 * i + 3], own)
        kinematics += components(rate_of_parent + own.ang_vel_in(parent) - omega, own)
        own.set_ang_vel(world, omega)
        center = joint.locatenew(f"G{i}", -length / 2 * own.z)
        center.v2pt_theory(joint, world, own)
        end = joint.locatenew(f"J{i}", -length * own.z)
        end.v2pt_theory(joint, world, own)
        bodies.append(RigidBody(f"body{i}", center, own, m, (inertia(own, *moments), center)))
        loads.append((center, -m * G * world.z))
        parent, rate_of_parent, joint = own, omega, end
    method = KanesMethod(world, q_ind=q, u_ind=u, kd_eqs=kinematics)
    return accelerations_by_sympy(method, bodies, loads, q, u)


def double_pendulum():
    angles, omegas, rates = SX.sym("angles", 6), SX.sym("omegas", 6), SX.sym("rates", 6)
    rotation, above, hinge = SX.eye(3), SX.zeros(3), SX.zeros(3)
    inertias, loads, kinematics = (), (), []
    for i, (m, length, moments) in enumerate(LINKS):
        own = slice(3 * i, 3 * i + 3)
        turn, relative = rotations.body_fixed((1, 2, 3), angles[own], rates[own])
        omega, rotation = omegas[own], rotation @ turn
        kinematics.append(turn.T @ above + relative - omega)
        down = -length * rotations.unit(3)
        hinge = turn.T @ hinge  # velocity of the upper joint, in the axes of this body
        velocity = hinge + ca.cross(omega, down / 2)
        inertias += kane.body(m, np.diag(moments), velocity, omega)
        loads += (kane.Load(velocity, rotation.T @ SX([0, 0, -m * G])),)
        above, hinge = omega, hinge + ca.cross(omega, down)
    equations = ca.vertcat(*kinematics)
    offset = ca.substitute(equations, rates, SX.zeros(6))
    q_dot = -ca.solve(ca.jacobian(equations, rates), offset)
    system = kane.System(q=angles, q_dot=q_dot, free=omegas, inertias=inertias, loads=loads)
    return system, omegas


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(rolling_disk, rolling_disk_by_sympy), (double_pendulum, double_pendulum_by_sympy)],
)
def test_accelerations_equal_those_of_kanes_method_in_sympy(ours, theirs):
    (system, speeds), expected = ours(), theirs()
    accelerations = kane.accelerations(system).unknown
    rng = np.random.default_rng(4)
    for _ in range(50):
        q, free = rng.uniform(-1.2, 1.2, system.q.numel()), rng.normal(size=system.free.numel())
        u = value(speeds, (system.free, free)).ravel()
        at = (system.q, q), (system.free, free), (system.dependent, u[free.size :])
        wanted = expected(q, u)
        error = np.abs(value(accelerations, *at).ravel() - wanted).max()
        assert error < 1e-12 * np.abs(wanted).max()  # measured 2e-15
