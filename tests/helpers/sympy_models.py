"""Systems of SymPy's documentation, with the equations that SymPy forms.

Source  docs.sympy.org, physics.mechanics, examples: rolling disc, four-bar linkage, bicycle.
"""

from math import acos, cos, hypot, pi, sin

import sympy as sm
from sympy.physics.mechanics import (
    KanesMethod,
    LagrangesMethod,
    Particle,
    Point,
    ReferenceFrame,
    RigidBody,
    System,
    dot,
    dynamicsymbols,
    inertia,
)

m, g, length = sm.symbols("m g l")
t = dynamicsymbols._t


def pendulum_by_kane() -> KanesMethod:
    q, u = dynamicsymbols("q u")
    N = ReferenceFrame("N")
    A = N.orientnew("A", "Axis", [q, N.z])
    A.set_ang_vel(N, u * N.z)
    P = Point("P")
    P.set_vel(N, length * u * A.y)
    kane = KanesMethod(N, [q], [u], [q.diff() - u])
    kane.kanes_equations([Particle("bob", P, m)], [(P, m * g * N.x)])
    return kane


def pendulum_by_lagrange() -> LagrangesMethod:
    q = dynamicsymbols("q")
    lagrange = LagrangesMethod(m * length**2 * q.diff() ** 2 / 2 + m * g * length * sm.cos(q), [q])
    lagrange.form_lagranges_equations()
    return lagrange


def pendulum_in_cartesian_coordinates() -> LagrangesMethod:
    """Return the pendulum in x (down) and y, its rod being a multiplier."""
    x, y = dynamicsymbols("x y")
    kinetic = m * (x.diff() ** 2 + y.diff() ** 2) / 2
    lagrange = LagrangesMethod(kinetic + m * g * x, [x, y], hol_coneqs=[x**2 + y**2 - length**2])
    lagrange.form_lagranges_equations()
    return lagrange


def pendulum_by_system(method=KanesMethod) -> System:
    q, u = dynamicsymbols("q u")
    ground = RigidBody("G")
    system = System.from_newtonian(ground)
    bob = Particle("bob", mass=m)
    frame = ReferenceFrame("A")
    frame.orient_axis(system.frame, q, system.z)
    frame.set_ang_vel(system.frame, (q.diff() if method is LagrangesMethod else u) * system.z)
    bob.masscenter.set_pos(system.fixed_point, length * frame.x)
    bob.masscenter.v2pt_theory(system.fixed_point, system.frame, frame)
    system.add_bodies(bob)
    system.add_coordinates(q)
    system.add_speeds(u)
    system.add_kdes(u - q.diff())
    system.apply_uniform_gravity(g * system.x)
    system.form_eoms(method)
    return system


def rolling_disc(*, forces: bool = False) -> tuple[KanesMethod, sm.Expr]:
    """Return the disc that rolls on a plane, and its energy; with the forces of the contact."""
    q1, q2, q3, u1, u2, u3 = dynamicsymbols("q1:4 u1:4")
    u4, u5, u6 = dynamicsymbols("u4:7")
    r, fx, fy, fz = sm.symbols("r fx fy fz")
    N = ReferenceFrame("N")
    Y = N.orientnew("Y", "Axis", [q1, N.z])
    L = Y.orientnew("L", "Axis", [q2, Y.x])
    R = L.orientnew("R", "Axis", [q3, L.y])
    R.set_ang_vel(N, u1 * L.x + u2 * L.y + u3 * L.z)
    R.set_ang_acc(N, R.ang_vel_in(N).dt(R))
    kinematics = [
        q1.diff() - u3 / sm.cos(q2),
        q2.diff() - u1,
        q3.diff() - u2 + u3 * sm.tan(q2),
    ]
    C = Point("C")
    C.set_vel(N, u4 * L.x + u5 * (Y.z ^ L.x) + u6 * Y.z if forces else 0)
    center = C.locatenew("center", r * L.z)
    center.set_vel(N, C.vel(N) + (R.ang_vel_in(N) ^ (r * L.z)))
    body = RigidBody(
        "disc", center, R, m, (inertia(L, m / 4 * r**2, m / 2 * r**2, m / 4 * r**2), center)
    )
    loads = [(center, -m * g * Y.z)]
    if forces:
        loads.append((C, fx * L.x + fy * (Y.z ^ L.x) + fz * Y.z))
    kane = KanesMethod(
        N, [q1, q2, q3], [u1, u2, u3], kinematics, u_auxiliary=[u4, u5, u6] if forces else []
    )
    kane.kanes_equations([body], loads)
    v, w = (R.ang_vel_in(N) ^ (r * L.z)), R.ang_vel_in(N)
    energy = m * dot(v, v) / 2 + dot(w, body.central_inertia.dot(w)) / 2 + m * g * r * sm.cos(q2)
    return kane, energy


def four_bar(method=KanesMethod) -> tuple[KanesMethod | LagrangesMethod, sm.Expr, list[sm.Expr]]:
    """Return three links on pins between two fixed points, their energy and their gap."""
    q1, q2, q3, u1, u2, u3 = dynamicsymbols("q1:4 u1:4")
    l1, l2, l3, l4, rho = sm.symbols("l1:5 rho")
    N = ReferenceFrame("N")
    ends = [Point("O")]
    ends[0].set_vel(N, 0)
    bodies, turn, rate = [], 0, 0
    lagrange = method is LagrangesMethod
    speeds = [q.diff() for q in (q1, q2, q3)] if lagrange else [u1, u2, u3]
    kinetic = potential = 0
    for i, (q, u, size) in enumerate(zip((q1, q2, q3), speeds, (l1, l2, l3), strict=True)):
        turn, rate = turn + q, rate + u
        frame = N.orientnew(f"A{i}", "Axis", [turn, N.z])
        frame.set_ang_vel(N, rate * N.z)
        center, end = (
            ends[-1].locatenew(f"G{i}", size / 2 * frame.x),
            ends[-1].locatenew(f"P{i}", size * frame.x),
        )
        center.v2pt_theory(ends[-1], N, frame)
        end.v2pt_theory(ends[-1], N, frame)
        body = RigidBody(
            f"B{i}", center, frame, rho * size, (inertia(frame, 0, 0, rho * size**3 / 12), center)
        )
        body.potential_energy = rho * size * g * dot(center.pos_from(ends[0]), N.y)
        kinetic, potential = kinetic + body.kinetic_energy(N), potential + body.potential_energy
        bodies.append(body)
        ends.append(end)
    gap = ends[-1].pos_from(ends[0]) - l4 * N.x
    closure = [dot(gap, N.x), dot(gap, N.y)]
    if lagrange:
        formed = LagrangesMethod(kinetic - potential, [q1, q2, q3], hol_coneqs=closure)
        formed.form_lagranges_equations()
    else:
        velocity = [dot(ends[-1].vel(N), N.x), dot(ends[-1].vel(N), N.y)]
        formed = KanesMethod(
            N, [q1], [u1], [q.diff() - u for q, u in ((q1, u1), (q2, u2), (q3, u3))],
            q_dependent=[q2, q3], configuration_constraints=closure,
            u_dependent=[u2, u3], velocity_constraints=velocity,
        )  # fmt: skip
        formed.kanes_equations(bodies, [(b.masscenter, -b.mass * g * N.y) for b in bodies])
    return formed, kinetic + potential, closure


def bicycle() -> tuple[KanesMethod, dict[sm.Symbol, float]]:
    """Return the nonlinear bicycle of SymPy's documentation, and the benchmark's parameters."""
    q1, q2, q4, q5 = dynamicsymbols("q1 q2 q4 q5")
    u1, u2, u3, u4, u5, u6 = dynamicsymbols("u1:7")
    names = (
        "WFrad WRrad htangle forkoffset forklength framelength forkcg1 forkcg3 framecg1 framecg3 "
        "Iwr11 Iwr22 Iwf11 Iwf22 Iframe11 Iframe22 Iframe33 Iframe31 Ifork11 Ifork22 Ifork33 "
        "Ifork31 g mframe mfork mwf mwr"
    )
    s = {name: sm.Symbol(name) for name in names.split()}
    N = ReferenceFrame("N")
    Y = N.orientnew("Y", "Axis", [q1, N.z])
    R = Y.orientnew("R", "Axis", [q2, Y.x])
    frame = R.orientnew("Frame", "Axis", [q4 + s["htangle"], R.y])
    WR, WF = ReferenceFrame("WR"), ReferenceFrame("WF")
    upright = frame.orientnew("TempFrame", "Axis", [-s["htangle"], frame.y])
    fork = frame.orientnew("Fork", "Axis", [q5, frame.x])
    upright_fork = fork.orientnew("TempFork", "Axis", [-s["htangle"], fork.y])
    rear_contact = Point("WR_cont")
    rear = rear_contact.locatenew("WR_mc", s["WRrad"] * R.z)
    steer = rear.locatenew("Steer", s["framelength"] * frame.z)
    frame_center = rear.locatenew("Frame_mc", -s["framecg1"] * frame.x + s["framecg3"] * frame.z)
    fork_center = steer.locatenew("Fork_mc", -s["forkcg1"] * fork.x + s["forkcg3"] * fork.z)
    front = steer.locatenew("WF_mc", s["forklength"] * fork.x + s["forkoffset"] * fork.z)
    down = (dot(fork.y, Y.z) * fork.y - Y.z).normalize()
    contact = front.locatenew("WF_cont", s["WFrad"] * down)
    Y.set_ang_vel(N, u1 * Y.z)
    R.set_ang_vel(Y, u2 * R.x)
    WR.set_ang_vel(frame, u3 * frame.y)
    frame.set_ang_vel(R, u4 * frame.y)
    fork.set_ang_vel(frame, u5 * fork.x)
    WF.set_ang_vel(fork, u6 * fork.y)
    rear_contact.set_vel(N, 0)
    rear.v2pt_theory(rear_contact, N, WR)
    steer.v2pt_theory(rear, N, frame)
    frame_center.v2pt_theory(rear, N, frame)
    fork_center.v2pt_theory(steer, N, fork)
    front.v2pt_theory(steer, N, fork)
    contact.v2pt_theory(front, N, WF)
    of = {
        "frame": inertia(upright, s["Iframe11"], s["Iframe22"], s["Iframe33"], 0, 0, s["Iframe31"]),
        "fork": inertia(upright_fork, s["Ifork11"], s["Ifork22"], s["Ifork33"], 0, 0, s["Ifork31"]),
        "rear": inertia(frame, s["Iwr11"], s["Iwr22"], s["Iwr11"]),
        "front": inertia(fork, s["Iwf11"], s["Iwf22"], s["Iwf11"]),
    }
    bodies = [
        RigidBody("frame", frame_center, frame, s["mframe"], (of["frame"], frame_center)),
        RigidBody("fork", fork_center, fork, s["mfork"], (of["fork"], fork_center)),
        RigidBody("rear", rear, WR, s["mwr"], (of["rear"], rear)),
        RigidBody("front", front, WF, s["mwf"], (of["front"], front)),
    ]
    kane = KanesMethod(
        N, [q1, q2, q5], [u2, u3, u5],
        [q.diff() - u for q, u in ((q1, u1), (q2, u2), (q4, u4), (q5, u5))],
        q_dependent=[q4], configuration_constraints=[dot(contact.pos_from(rear_contact), Y.z)],
        u_dependent=[u1, u4, u6],
        velocity_constraints=[dot(contact.vel(N), axis) for axis in (Y.x, Y.y, Y.z)],
        constraint_solver="CRAMER",
    )  # fmt: skip
    kane.kanes_equations(bodies, [(b.masscenter, -b.mass * s["g"] * Y.z) for b in bodies])
    rear_radius, front_radius, base, tilt = 0.3, 0.35, 1.02, pi / 2 - pi / 10
    rake = front_radius * cos(tilt) - 0.08 * sin(tilt)
    fork_length = base * cos(tilt) - (front_radius - rear_radius) * sin(tilt)
    a, b = 0.7 - front_radius, base - 0.9  # mass center of the fork from the front hub
    angle = pi / 2 - tilt - acos(a / hypot(a, b))
    height = 0.9 - rear_radius - 0.3 / sin(tilt) * cos(tilt)
    values = (
        front_radius, rear_radius, tilt, rake, fork_length,
        base * sin(tilt) - rake + (front_radius - rear_radius) * cos(tilt),
        hypot(a, b) * cos(angle) - fork_length, rake + hypot(a, b) * sin(angle),
        height * sin(tilt), 0.3 / sin(tilt) + height * cos(tilt),
        0.0603, 0.12, 0.1405, 0.28, 9.2, 11, 2.8, -2.4, 0.05892, 0.06, 0.00708, 0.00756,
        9.81, 85, 4, 3, 2,
    )  # fmt: skip
    return kane, dict(zip(s.values(), values, strict=True))
