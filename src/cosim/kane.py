"""The public import path of `casadi_models.mechanics.kane`."""

from casadi_models.mechanics.kane import *  # noqa: F403 (the whole module)
