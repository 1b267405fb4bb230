"""The public import path of `casadi_models.mechanics.contact`."""

from casadi_models.mechanics.contact import *  # noqa: F403 (the whole module)
