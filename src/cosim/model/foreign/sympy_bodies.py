"""Bodies and loads of SymPy's `KanesMethod` as inertias and loads of `kane`.

SymPy multiplies vectors out in all frames that they have components in. Here, each one is resolved
in one frame that carries its body, and the bodies of one frame become one: a bicycle takes about
two thirds of the operations.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import are_equal
from casadi_models.mechanics import kane
from cosim.host.optional_packages import optional_module
from cosim.model.foreign.sympy_printer import printed


class _Carrier(kane.Carrier):
    """A frame of SymPy whose base point is the mass center of its first body."""

    def __init__(self, vectors: "_Vectors", frame: Any, base: Any) -> None:
        self.frame, self.base = frame, base
        velocity = vectors.column(base.vel(vectors.inertial), frame)
        super().__init__(velocity, vectors.column(frame.ang_vel_in(vectors.inertial), frame))


class _Vectors:
    """Vectors of SymPy, resolved in frames along the tree of orientations."""

    def __init__(self, who: str, inertial: Any, values: Mapping[Any, SX], moving: SX) -> None:
        self.who, self.inertial, self.values, self.moving = who, inertial, dict(values), moving
        self.rotations = dict[Any, SX]()

    def printed(self, matrix: Any) -> SX:
        core = optional_module("sympy.core.function", "sympy")
        leaves = matrix.free_symbols | matrix.atoms(core.AppliedUndef, core.Derivative)
        for leaf in leaves - self.values.keys():
            self.values[leaf] = SX(1)  # not in SymPy's equations: any number has no effect
        return printed(self.who, {"matrix": matrix}, self.values)["matrix"]

    def rotation(self, frame: Any, other: Any) -> SX:
        """Return R of v(frame) = R v(other) for neighbors in the tree."""
        if (other, frame) in self.rotations:
            return self.rotations[other, frame].T
        if (frame, other) not in self.rotations:
            self.rotations[frame, other] = self.printed(frame.dcm(other))
        return self.rotations[frame, other]

    def turned(self, column: SX, other: Any, frame: Any) -> SX:
        """Resolve columns that are given in one frame in another one."""
        for nearer, farther in pairwise(other._dict_list(frame, 0)):
            column = self.rotation(farther, nearer) @ column
        return column

    def column(self, vector: Any, frame: Any) -> SX:
        parts = (self.turned(self.printed(m), other, frame) for m, other in vector.args)
        return sum(parts, SX(3, 1))

    def is_fixed(self, place: SX) -> bool:
        return not ca.depends_on(place, self.moving)

    def inertia(self, body: Any) -> tuple[Any, SX]:
        """Return a frame in which a body's inertia is constant, and the inertia, (3, 3)."""
        if not hasattr(body, "central_inertia"):  # a particle
            components = body.masscenter.vel(self.inertial).args
            return components[-1][1] if components else self.inertial, SX(3, 3)
        terms = body.central_inertia.args
        if not terms:
            return body.frame, SX(3, 3)
        frame = terms[0][1].args[0][1]
        inertia = self.printed(body.central_inertia.to_matrix(frame))
        try:
            turn = self.turned(SX.eye(3), frame, body.frame)
        except ValueError:  # the frame of a wheel may have no orientation
            return frame, inertia
        return (body.frame, turn @ inertia @ turn.T) if self.is_fixed(turn) else (frame, inertia)

    def fixed_in(self, carriers: list[_Carrier], point: Any) -> tuple[_Carrier, SX] | None:
        """Return the first carrier in which a point is fixed, and its place there, (3, 1)."""
        for carrier in carriers:
            try:
                place = self.column(point.pos_from(carrier.base), carrier.frame)
                velocity = self.column(point.vel(self.inertial), carrier.frame)
            except ValueError:  # the position is not known, or not in this frame
                continue
            carried = carrier.velocity + ca.cross(carrier.omega, place)
            if self.is_fixed(place) and are_equal(velocity, carried):
                return carrier, place
        return None


def inertias_and_loads(
    who: str, method: Any, values: Mapping[Any, SX], moving: SX
) -> tuple[tuple[kane.InertialTerm, ...], tuple[kane.Load, ...]]:
    """Return the bodies and loads of a `KanesMethod` whose equations are formed.

    Args:
        who: For messages.
        method: The method.
        values: SX of symbols and functions of time, and of the rates of coordinates.
        moving: Those that change with time, a column.

    Raises:
        UsageError: Something has no CasADi form.
        ValueError: Frames or points are not connected.
    """
    vectors, loads = _Vectors(who, method._inertial, values, moving), list[kane.Load]()
    carriers = list[_Carrier]()
    for body in method.bodies:
        frame, inertia = vectors.inertia(body)
        own = [carrier for carrier in carriers if carrier.frame is frame]
        carrier, place = vectors.fixed_in(own, body.masscenter) or (None, SX(3, 1))
        if carrier is None:
            carriers.append(carrier := _Carrier(vectors, frame, body.masscenter))
        turned = getattr(body, "frame", frame)
        spin = SX(3, 1) if turned is frame else vectors.column(turned.ang_vel_in(frame), frame)
        mass = vectors.printed(optional_module("sympy", "sympy").Matrix([body.mass]))
        carrier.parts.append(kane.Part(mass, place, inertia, spin))
    for body, vector in method.loads or []:
        if hasattr(body, "vel") and (found := vectors.fixed_in(carriers, body)):
            carrier, place = found
            force = vectors.column(vector, carrier.frame)
            carrier.force += force
            carrier.moment += ca.cross(place, force)
        elif vector.args:
            frame = vector.args[0][1]
            rate = (body.vel if hasattr(body, "vel") else body.ang_vel_in)(vectors.inertial)
            loads.append(kane.Load(vectors.column(rate, frame), vectors.column(vector, frame)))
    inertias = tuple(term for carrier in carriers for term in carrier.inertias())
    return inertias, (*loads, *(load for carrier in carriers for load in carrier.loads()))
