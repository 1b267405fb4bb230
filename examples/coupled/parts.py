"""Parts of coupled systems: masses with springs, a quarter car, two pendulums, a motor, loops.

Each function returns one part. `quarter_car.toml` and its neighbors couple them.
"""

import casadi as ca

from casadi_models.dae import Dae, Model


def oscillator(name: str = "oscillator", x: float = 1.0, stiffness: float = 10.0) -> Dae:
    """Return a mass on a spring and a damper that takes a force and gives its motion."""
    model = Model(name, description="a mass on a spring, pushed by a force", stop_time=10.0)
    position = model.state("x", "m", x, "displacement")
    speed = model.state("v", "m/s", 0.0, "speed")
    force = model.input("force", "N", 0.0, "force from outside")
    mass = model.parameter("mass", "kg", 1.0, "mass", minimum=1e-9)
    c = model.parameter("stiffness", "N/m", stiffness, "stiffness of the spring")
    d = model.parameter("damping", "N.s/m", 0.0, "damping")
    model.derivative(position, speed)
    model.derivative(speed, (force - c * position - d * speed) / mass)
    model.output("energy", "J", (mass * speed**2 + c * position**2) / 2, "energy")
    return model.freeze()


def coupled_oscillator() -> Dae:
    """Return a mass that takes the motion of another one and gives the force between them."""
    model = Model("coupled_oscillator", description="a mass on two springs", stop_time=10.0)
    position = model.state("x", "m", 0.0, "displacement")
    speed = model.state("v", "m/s", 0.0, "speed")
    other = model.input("x_other", "m", 0.0, "displacement of the other mass")
    other_speed = model.input("v_other", "m/s", 0.0, "speed of the other mass")
    mass = model.parameter("mass", "kg", 1.0, "mass", minimum=1e-9)
    c = model.parameter("stiffness", "N/m", 10.0, "stiffness of its own spring")
    ck = model.parameter("coupling_stiffness", "N/m", 1.0, "stiffness of the spring between")
    dk = model.parameter("coupling_damping", "N.s/m", 0.0, "damping between the masses")
    force = ck * (position - other) + dk * (speed - other_speed)
    model.derivative(position, speed)
    model.derivative(speed, (-force - c * position) / mass)
    model.output("force", "N", force, "force on the other mass")
    energy = (mass * speed**2 + c * position**2 + ck * (position - other) ** 2) / 2
    model.output("energy", "J", energy, "energy, that of the spring between included")
    return model.freeze()


def first_mass() -> Dae:
    """Return the mass of a dual-mass oscillator that is displaced at the start."""
    return oscillator("first_mass")


def middle_mass() -> Dae:
    """Return a mass between two others: it takes the forces of both."""
    model = Model("middle_mass", description="a mass between two others", stop_time=10.0)
    position = model.state("x", "m", 0.5, "displacement")
    speed = model.state("v", "m/s", 0.0, "speed")
    left, right = (model.input(f"force_{s}", "N", 0.0, f"force from the {s}") for s in ("1", "2"))
    mass = model.parameter("mass", "kg", 2.0, "mass", minimum=1e-9)
    model.derivative(position, speed)
    model.derivative(speed, (left + right) / mass)
    return model.freeze()


def wheel() -> Dae:
    """Return the unsprung mass of a quarter car, which drives over a bump."""
    model = Model("wheel", description="a wheel on a road with a bump", stop_time=3.0)
    position = model.state("x", "m", 0.0, "height above the place of rest", nominal=0.01)
    speed = model.state("v", "m/s", 0.0, "speed", nominal=0.1)
    force = model.input("force", "N", 0.0, "force of the suspension", nominal=1000.0)
    mass = model.parameter("mass", "kg", 40.0, "mass", minimum=1e-9)
    c = model.parameter("stiffness", "N/m", 150e3, "stiffness of the tyre")
    height = model.parameter("height", "m", 0.1, "height of the bump")
    road = height * ca.exp(-(((model.t - 1) / 0.15) ** 2))
    model.derivative(position, speed)
    model.derivative(speed, (force - c * (position - road)) / mass)
    tyre = c * (road - position)
    model.output("tyre_force", "N", tyre, "change of the force on the road", nominal=1000.0)
    return model.freeze()


def chassis() -> Dae:
    """Return the sprung mass of a quarter car and its suspension."""
    model = Model("chassis", description="a chassis on its suspension", stop_time=3.0)
    position = model.state("x", "m", 0.0, "height above the place of rest", nominal=0.01)
    speed = model.state("v", "m/s", 0.0, "speed", nominal=0.1)
    wheel_x = model.input("x_wheel", "m", 0.0, "height of the wheel", nominal=0.01)
    wheel_v = model.input("v_wheel", "m/s", 0.0, "speed of the wheel", nominal=0.1)
    mass = model.parameter("mass", "kg", 400.0, "mass", minimum=1e-9)
    c = model.parameter("stiffness", "N/m", 15e3, "stiffness of the suspension")
    d = model.parameter("damping", "N.s/m", 1e3, "damping of the suspension")
    force = c * (position - wheel_x) + d * (speed - wheel_v)
    model.derivative(position, speed)
    model.derivative(speed, -force / mass)
    model.output("force", "N", force, "force on the wheel", nominal=1000.0)
    return model.freeze()


def upper_bar() -> Dae:
    """Return a bar that hangs on a hinge; a force acts at its lower end."""
    model = Model("upper_bar", description="a bar on a hinge", stop_time=2.0)
    phi = model.state("phi", "rad", 1.0, "angle from below")
    rate = model.state("omega", "rad/s", 0.0, "rate of that angle")
    fx, fy = model.input("fx", "N", 0.0, "force, right"), model.input("fy", "N", 0.0, "force, up")
    mass, length = model.parameter("m", "kg", 1.0, "mass"), model.parameter("l", "m", 1.0, "length")
    g = model.parameter("g", "m/s2", 9.81, "acceleration of gravity")
    moment = length * (ca.cos(phi) * fx + ca.sin(phi) * fy) - mass * g * length / 2 * ca.sin(phi)
    model.derivative(phi, rate)
    model.derivative(rate, moment / (mass * length**2 / 3))
    model.output("x", "m", length * ca.sin(phi), "place of the lower end, right")
    model.output("y", "m", -length * ca.cos(phi), "place of the lower end, up")
    model.output("vx", "m/s", length * rate * ca.cos(phi), "speed of the lower end, right")
    model.output("vy", "m/s", length * rate * ca.sin(phi), "speed of the lower end, up")
    return model.freeze()


def lower_bar() -> Dae:
    """Return a free bar whose upper end a stiff spring and a damper hold at a moving point."""
    model = Model("lower_bar", description="a bar on a stiff hinge that moves", stop_time=2.0)
    m, length = model.parameter("m", "kg", 1.0, "mass"), model.parameter("l", "m", 1.0, "length")
    g = model.parameter("g", "m/s2", 9.81, "acceleration of gravity")
    c = model.parameter("stiffness", "N/m", 1e4, "stiffness of the hinge")
    d = model.parameter("damping", "N.s/m", 20.0, "damping of the hinge")
    x, y = model.state("x", "m", 0.0, "middle, right"), model.state("y", "m", 0.0, "middle, up")
    vx, vy = model.state("vx", "m/s", 0.0, "speed, right"), model.state("vy", "m/s", 0.0, "up")
    phi = model.state("phi", "rad", 0.0, "angle from below")
    rate = model.state("omega", "rad/s", 0.0, "rate of that angle")
    names = (("x_hinge", "m"), ("y_hinge", "m"), ("vx_hinge", "m/s"), ("vy_hinge", "m/s"))
    hinge = [model.input(name, unit, 0.0, "motion of the hinge") for name, unit in names]
    model.start(x, hinge[0], "the bar hangs from the hinge")
    model.start(y, hinge[1] - length / 2, "the bar hangs from the hinge")
    arm_x, arm_y = -length / 2 * ca.sin(phi), length / 2 * ca.cos(phi)  # to the upper end
    fx = c * (hinge[0] - x - arm_x) + d * (hinge[2] - vx + rate * arm_y)
    fy = c * (hinge[1] - y - arm_y) + d * (hinge[3] - vy - rate * arm_x)
    for state, slope in (
        (x, vx),
        (y, vy),
        (vx, fx / m),
        (vy, fy / m - g),
        (phi, rate),
        (rate, (arm_x * fy - arm_y * fx) / (m * length**2 / 12)),
    ):
        model.derivative(state, slope)
    model.output("fx", "N", -fx, "force on what holds the hinge, right", nominal=10.0)
    model.output("fy", "N", -fy, "force on what holds the hinge, up", nominal=10.0)
    return model.freeze()


def motor() -> Dae:
    """Return a motor: voltage and speed in, torque out."""
    model = Model("motor", description="a motor with a winding", stop_time=2.0)
    current = model.state("current", "A", 0.0, "current")
    speed = model.input("speed", "rad/s", 0.0, "speed of the axle")
    voltage = model.input("voltage", "V", 2.0, "voltage")
    constant = model.parameter("constant", "N.m/A", 0.2, "torque by current")
    resistance = model.parameter("resistance", "V/A", 1.0, "resistance of the winding")
    inductance = model.parameter("inductance", "H", 0.02, "inductance of the winding")
    model.derivative(current, (voltage - resistance * current - constant * speed) / inductance)
    model.output("torque", "N.m", constant * current, "torque on the axle")
    return model.freeze()


def lag(gain: float) -> Dae:
    """Return a first-order lag whose output feels its input at once."""
    model = Model("lag", description="a lag with direct feedthrough", stop_time=5.0)
    x = model.state("x", "1", 1.0, "state")
    u = model.input("u", "1", 0.0, "input")
    k = model.parameter("gain", "1", gain, "direct feedthrough")
    model.derivative(x, u - x)
    model.output("y", "1", x + k * u, "output")
    return model.freeze()


def lag_up() -> Dae:
    """Return a lag with a direct feedthrough of 1."""
    return lag(1.0)


def lag_down() -> Dae:
    """Return a lag with a direct feedthrough of -0.4: a loop with `lag_up` has this gain."""
    return lag(-0.4)


def lag_far_down() -> Dae:
    """Return a lag with a direct feedthrough of -2.5."""
    return lag(-2.5)


def digital_rider() -> Dae:
    """Return a computer that balances the bicycle: it measures and sets torques every 20 ms."""
    model = Model("digital_rider", description="state feedback, sampled and held", stop_time=2.0)
    measured = ca.vertcat(
        *(model.input(name, "rad", 0.0, f"{name} as measured") for name in ("phi", "delta")),
        *(model.input(f"{n}_dot", "rad/s", 0.0, f"rate of {n}") for n in ("phi", "delta")),
    )
    gains = {"steer": (-22.88, 18.26, -5.68, 1.75), "roll": (10.08, -6.73, 2.73, -0.63)}
    held = {n: model.discrete(f"{n}_held", "N.m", 0.0, f"{n} torque that is held") for n in gains}
    model.every(
        0.02, {held[n]: -ca.dot(ca.DM(k), measured) for n, k in gains.items()}, name="sample"
    )
    for name, torque in held.items():
        model.output(f"{name}_torque", "N.m", torque, f"{name} torque on the bicycle")
    return model.freeze()
