"""A robot arm from a URDF file: a chain of hinges from the ground to the flange, with torques.

Source  Featherstone, Rigid Body Dynamics Algorithms, 2008, section 7.3; the file follows
        wiki.ros.org/urdf/XML. A test compares the accelerations with those of Pinocchio.
"""

from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
from casadi import SX

from casadi_models.dae import Model
from casadi_models.mechanics.articulated import Link, accelerations
from casadi_models.mechanics.rotations import about

FILE = Path(__file__).with_name("arm.urdf")


def numbers(element, key="xyz"):
    """Return the three numbers of an attribute, zeros where it is missing."""
    return SX([float(word) for word in element.get(key, "0 0 0").split()])


def turned(origin):
    """Return the rotation of roll, pitch and yaw, (3, 3)."""
    roll, pitch, yaw = ca.vertsplit(numbers(origin, "rpy"))
    return about(3, yaw) @ about(2, pitch) @ about(1, roll)


def build(file=FILE):
    """Return the ODE: angle and rate of each hinge; the torques of the drives are inputs."""
    robot = ElementTree.parse(file).getroot()
    model = Model(robot.get("name"), description="arm of a URDF file", stop_time=2.0)
    q, u, torques, links, place, turn, child = [], [], [], [], SX(3, 1), SX.eye(3), None
    for i, joint in enumerate(robot.iter("joint")):
        if i and joint.find("parent").get("link") != child:
            raise ValueError(f"{file}: the joints do not form a chain in the order of the file")
        parent, child = (joint.find(end).get("link") for end in ("parent", "child"))
        name, origin, axis = joint.get("name"), joint.find("origin"), numbers(joint.find("axis"))
        q.append(model.state(name, "rad", 0.2, f"angle of {name}"))
        u.append(model.state(f"{name}_rate", "rad/s", 0.0, f"rate of {name}"))
        drive = model.input(f"{name}_torque", "N.m", 0.0, f"torque of the drive of {name}")
        torques.append(drive - float(joint.find("dynamics").get("damping")) * u[i])
        spin = ca.skew(axis)
        hinge = SX.eye(3) + ca.sin(q[i]) * spin + (1 - ca.cos(q[i])) * spin @ spin
        body = robot.find(f"link[@name='{child}']/inertial")
        moments, center = body.find("inertia"), body.find("origin")
        rows = [[float(moments.get("i" + "".join(sorted(a + b)))) for a in "xyz"] for b in "xyz"]
        inertia = turned(center) @ ca.DM(rows) @ turned(center).T
        mass, rotation = float(body.find("mass").get("value")), turned(origin) @ hinge
        links.append(Link(i - 1, numbers(origin), rotation, axis, mass, numbers(center), inertia))
        place, turn = place + turn @ links[i].place, turn @ rotation
        model.body(child, place, turn)
        if i:
            model.rod(parent, (SX(3, 1), links[i].place), 0.04, body=parent)
    found = accelerations(links, ca.vertcat(*u), ca.vertcat(*torques), SX([0, 0, -9.81]))
    model.derivative(ca.vertcat(*q, *u), ca.vertcat(*u, found))
    for axis, value in zip("xyz", ca.vertsplit(place), strict=True):
        model.output(f"{axis}_flange", "m", value, f"place of the flange along {axis}")
    return model.freeze()
