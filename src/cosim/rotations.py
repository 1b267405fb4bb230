"""The public import path of `casadi_models.mechanics.rotations`."""

from casadi_models.mechanics.rotations import *  # noqa: F403 (the whole module)
