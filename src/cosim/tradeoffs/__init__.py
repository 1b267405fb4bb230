"""Error against cost of solvers, tolerances, steps, formulations and roads."""

from cosim.tradeoffs.configuration import ROADS, Configuration, Selection
from cosim.tradeoffs.measurement import COSTS, Measurement
from cosim.tradeoffs.result import Tradeoff
from cosim.tradeoffs.study import tradeoff

__all__ = [
    "COSTS",
    "ROADS",
    "Configuration",
    "Measurement",
    "Selection",
    "Tradeoff",
    "tradeoff",
]
