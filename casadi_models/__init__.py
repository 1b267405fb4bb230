"""Mechanical systems as symbolic DAEs; imports CasADi only.

A system is a folder, a formulation a file in it: `bicycle/book` is what `build()` of
`casadi_models/bicycle/book.py` returns, as with a builder in a user's own file.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from casadi_models.dae import Dae

# model/formulation; the first formulation of a model is its default
CATALOG: tuple[str, ...] = (
    "crank_shaft/driven",
    "crank_shaft/multipliers",
    "bar_on_frame/reduced",
    "bar_on_frame/two_body",
    "bicycle/independent",
    "bicycle/book",
    "bicycle/multipliers",
    "disk_two_bars/reduced",
    "disk_two_bars/multipliers",
    "double_pendulum/quaternion",
    "double_pendulum/euler_313",
    "double_pendulum/euler_313_axial",
    "double_pendulum/multipliers",
)


def load(name: str) -> "Dae":
    """Build the DAE of `MODEL` or `MODEL/FORMULATION`.

    Raises:
        KeyError: The catalogue does not have it.
    """
    full = next((entry for entry in CATALOG if name in (entry, entry.partition("/")[0])), None)
    if full is None:
        raise KeyError(name)
    module = import_module(f"casadi_models.{full.replace('/', '.')}")
    dae: Dae = module.build()
    return dae
