"""Names of physical quantities by unit, as Modelica's library of SI units has them."""

from collections.abc import Mapping

QUANTITIES: Mapping[str, str] = {
    "s": "Time",
    "rad": "Angle",
    "rad/s": "AngularVelocity",
    "rad/s2": "AngularAcceleration",
    "m": "Length",
    "m/s": "Velocity",
    "m/s2": "Acceleration",
    "kg": "Mass",
    "kg/m3": "Density",
    "kg.m2": "MomentOfInertia",
    "kg.m2/s": "AngularMomentum",
    "N": "Force",
    "N.m": "Torque",
    "J": "Energy",
    "W": "Power",
    "N/m": "TranslationalSpringConstant",
    "N.s/m": "TranslationalDampingConstant",
    "N.m/rad": "RotationalSpringConstant",
    "N.m.s/rad": "RotationalDampingConstant",
}
