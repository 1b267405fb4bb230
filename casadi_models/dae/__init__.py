"""`Dae`: a semi-explicit symbolic DAE that knows its variables; `Model`: the builder of one.

    x' = ode(t, x, z, u, p)      0 = alg(t, x, z, u, p)      outputs = y(t, x, z, u, p)

The symbols and expressions are plain CasADi `SX`; every variable carries unit, display unit,
meaning, start value, nominal value and bounds, which travel with it to XML, CSV and axis labels.
"""

from casadi_models.dae.drawing import Drawing
from casadi_models.dae.events import smooth
from casadi_models.dae.family import Family
from casadi_models.dae.frozen import Dae
from casadi_models.dae.invariants import Closing, Invariant
from casadi_models.dae.model import Model
from casadi_models.dae.starts import StartRule, StartThrough
from casadi_models.dae.variables import Experiment, ModeNames, Start, Variable

__all__ = [
    "Closing",
    "Dae",
    "Drawing",
    "Experiment",
    "Family",
    "Invariant",
    "ModeNames",
    "Model",
    "Start",
    "StartRule",
    "StartThrough",
    "Variable",
    "smooth",
]
