"""3-1-3 angles with links along -3: hanging is singular (the stress case)."""

from casadi import SX

from casadi_models.dae import Dae
from casadi_models.double_pendulum.euler import in_angles


def build() -> Dae:
    """Return the ODE in 3-1-3 angles with links along -3, hanging singular: 12 states."""
    return in_angles("euler_313_axial", 3, SX([1, 0, 0, 0]), SX.eye(3))
