"""A disc that rolls on a plane, by SymPy's KanesMethod; the force of the ground is an output.

Source  docs.sympy.org, physics.mechanics, rolling disc.
"""

from sympy import cos, symbols, tan
from sympy.physics import mechanics as me

import cosim


def build():
    """Return the ODE: 6 states (yaw, lean, spin, and the angular velocity in leaning axes)."""
    q1, q2, q3, u1, u2, u3, u4 = me.dynamicsymbols("q1:4 u1:5")  # u4 is an auxiliary speed
    m, g, r, fz = symbols("m g r fz")
    N, disc = me.ReferenceFrame("N"), me.ReferenceFrame("disc")
    Y = N.orientnew("Y", "Axis", [q1, N.z])
    L = Y.orientnew("L", "Axis", [q2, Y.x])
    disc.orient_axis(L, q3, L.y)
    disc.set_ang_vel(N, u1 * L.x + u2 * L.y + u3 * L.z)
    contact = me.Point("contact")
    contact.set_vel(N, u4 * N.z)
    center = contact.locatenew("center", r * L.z)
    center.set_vel(N, contact.vel(N) + disc.ang_vel_in(N).cross(r * L.z))
    inertia = me.inertia(L, m / 4 * r**2, m / 2 * r**2, m / 4 * r**2)
    body = me.RigidBody("disc", center, disc, m, (inertia, center))
    rates = [q1.diff() - u3 / cos(q2), q2.diff() - u1, q3.diff() - u2 + u3 * tan(q2)]
    kane = me.KanesMethod(N, [q1, q2, q3], [u1, u2, u3], rates, u_auxiliary=[u4])
    kane.kanes_equations([body], [(center, -m * g * N.z), (contact, fz * N.z)])
    values, starts = {m: 2.0, g: 9.81, r: 0.5}, {q2: 0.2, u2: 6.0, u3: 0.3}
    return cosim.from_sympy(
        kane, values, starts, {"height": r * cos(q2)}, name="rolling_disc",
        units={m: "kg", g: "m/s2", r: "m", fz: "N", "height": "m", q1: "rad", q2: "rad", q3: "rad",
               u1: "rad/s", u2: "rad/s", u3: "rad/s"},
    )  # fmt: skip
