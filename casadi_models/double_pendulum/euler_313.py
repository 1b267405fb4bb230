"""The book's 3-1-3 angles, links along -2: hanging is regular."""

from math import pi

from casadi import SX

from casadi_models.dae import Dae
from casadi_models.double_pendulum.euler import in_angles
from casadi_models.mechanics import rotations

# Turns components in L into components in E, the frame of the book's angles: the axes 1 agree,
# and axis 2 of E is z of L. The matrix is written out so that its zeros are exact.
TO_BOOK = rotations.quaternion_about(1, SX(-pi / 2))
BOOK_AXES = SX([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def build() -> Dae:
    """Return the ODE in 3-1-3 angles with links along -2 (the book's), hanging regular: 12 states.

    Singular where axis 3 of a link's frame E is vertical, which needs a horizontal link.
    """
    return in_angles("euler_313", 2, TO_BOOK, BOOK_AXES)
