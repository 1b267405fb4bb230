"""A robot arm from a URDF file: hinges from the ground to the tip, driven by torques.

Source  Featherstone, Rigid Body Dynamics Algorithms, 2008, section 7.3; the file follows
        wiki.ros.org/urdf/XML. A test compares the accelerations with those of Pinocchio.
"""

from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Model
from casadi_models.mechanics.articulated import Link, accelerations
from casadi_models.mechanics.rotations import about

FILE = Path(__file__).with_name("arm.urdf")


def numbers(element, key):
    """Return the three numbers of an attribute, zeros where it is missing."""
    text = "0 0 0" if element is None else element.get(key, "0 0 0")
    return np.array([float(word) for word in text.split()])


def turned(element):
    """Return the rotation of roll, pitch and yaw, (3, 3)."""
    roll, pitch, yaw = numbers(element, "rpy")
    return about(3, yaw) @ about(2, pitch) @ about(1, roll)


def hinge(axis, angle):
    """Return the rotation about a unit axis, (3, 3)."""
    spin = ca.skew(ca.DM(axis))
    return SX.eye(3) + ca.sin(angle) * spin + (1 - ca.cos(angle)) * spin @ spin


def masses(body):
    """Return mass, mass center, (3, 1), and inertia about it in the link's axes, (3, 3)."""
    moments = {key: float(value) for key, value in body.find("inertia").items()}
    inertia = ca.DM([[moments["i" + "".join(sorted(a + b))] for a in "xyz"] for b in "xyz"])
    origin = body.find("origin")
    turn = turned(origin)
    mass = float(body.find("mass").get("value"))
    return mass, SX(numbers(origin, "xyz")), turn @ inertia @ turn.T


def build(file=FILE):
    """Return the ODE: angle and rate of each revolute joint; the torques are inputs."""
    robot = ElementTree.parse(file).getroot()
    joints = [joint for joint in robot.iter("joint") if joint.get("type") != "fixed"]
    model = Model(robot.get("name"), description="arm of a URDF file", stop_time=2.0)
    children = [joint.find("child").get("link") for joint in joints]
    q, u, torques, links, place, turn = [], [], [], [], {"base": SX(3, 1)}, {"base": SX.eye(3)}
    for joint, child in zip(joints, children, strict=True):
        name, parent = joint.get("name"), joint.find("parent").get("link")
        q.append(model.state(name, "rad", 0.2, f"angle of {name}"))
        u.append(model.state(f"{name}_rate", "rad/s", 0.0, f"rate of {name}"))
        damping = float(joint.find("dynamics").get("damping"))
        torque = model.input(f"{name}_torque", "N.m", 0.0, f"torque of the drive of {name}")
        torques.append(torque - damping * u[-1])
        carrier = children.index(parent) if parent in children else -1
        axis = numbers(joint.find("axis"), "xyz")
        rotation = turned(joint.find("origin")) @ hinge(axis, q[-1])
        place_of_hinge = SX(numbers(joint.find("origin"), "xyz"))
        body = robot.find(f"link[@name='{child}']/inertial")
        links.append(Link(carrier, place_of_hinge, rotation, SX(axis), *masses(body)))
        place[child] = place[parent] + turn[parent] @ links[-1].place
        turn[child] = turn[parent] @ rotation
        model.body(child, place[child], turn[child])
        model.shape(name, "cylinder", [0.05, 0.1], body=child, along=axis)
        if parent != "base":
            model.rod(parent, (SX(3, 1), links[-1].place), 0.03, body=parent)
    found = accelerations(links, ca.vertcat(*u), ca.vertcat(*torques), SX([0, 0, -9.81]))
    model.derivative(ca.vertcat(*q, *u), ca.vertcat(*u, found))
    model.shape("foot", "cylinder", [0.08, 0.06], at=[0, 0, 0.03], color="#999999")
    model.rod("tool", (SX(3, 1), SX([0, 0.1, 0])), 0.02, body=children[-1])
    for axis, value in zip("xyz", ca.vertsplit(place[children[-1]]), strict=True):
        model.output(f"{axis}_flange", "m", value, f"place of the flange along {axis}")
    return model.freeze()
