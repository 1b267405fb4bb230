"""A robot arm from a URDF file: hinges from the ground to the flange, with torques of the drives.

Source  Featherstone, Rigid Body Dynamics Algorithms, 2008, section 7.3; the file follows
        wiki.ros.org/urdf/XML. A test compares the accelerations with those of Pinocchio.
"""

from pathlib import Path

import casadi as ca
from casadi import SX
from yourdfpy import URDF

from casadi_models.dae import Model
from casadi_models.mechanics.articulated import Link, accelerations

FILE = Path(__file__).with_name("arm.urdf")


def build(file=FILE):
    """Return the ODE: angle and rate of each hinge; the torques of the drives are inputs."""
    robot = URDF.load(file, load_meshes=False, build_scene_graph=False).robot
    model = Model(robot.name, description="arm of a URDF file", stop_time=2.0)
    bodies = {link.name: link.inertial for link in robot.links}
    number = {joint.child: i for i, joint in enumerate(robot.joints)}
    q, u, torques, links, poses = [], [], [], [], {}
    for joint in robot.joints:
        name, axis, body = joint.name, SX(joint.axis), bodies[joint.child]
        q.append(model.state(name, "rad", 0.2, f"angle of {name}"))
        u.append(model.state(f"{name}_rate", "rad/s", 0.0, f"rate of {name}"))
        drive = model.input(f"{name}_torque", "N.m", 0.0, f"torque of the drive of {name}")
        torques.append(drive - float(joint.dynamics.damping) * u[-1])
        origin, spin, axes = joint.origin, ca.skew(axis), body.origin[:3, :3]
        hinge = SX.eye(3) + ca.sin(q[-1]) * spin + (1 - ca.cos(q[-1])) * spin @ spin
        place, rotation = SX(origin[:3, 3]), origin[:3, :3] @ hinge
        inertia, center = SX(axes @ body.inertia @ axes.T), SX(body.origin[:3, 3])
        parent = number.get(joint.parent, -1)
        links.append(Link(parent, place, rotation, axis, body.mass, center, inertia))
        foot, turn = poses.get(joint.parent, (SX(3, 1), SX.eye(3)))
        poses[joint.child] = foot + turn @ place, turn @ rotation
        model.body(joint.child, *poses[joint.child])
        if parent >= 0:
            model.rod(joint.parent, (SX(3, 1), place), 0.04, body=joint.parent)
    found = accelerations(links, ca.vertcat(*u), ca.vertcat(*torques), SX([0, 0, -9.81]))
    model.derivative(ca.vertcat(*q, *u), ca.vertcat(*u, found))
    for axis, value in zip("xyz", ca.vertsplit(poses[joint.child][0]), strict=True):
        model.output(f"{axis}_flange", "m", value, f"place of the flange along {axis}")
    return model.freeze()
