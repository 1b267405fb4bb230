"""Parameters that become numbers."""

from collections.abc import Collection

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae
from cosim.errors import UnknownName


def frozen_at_start(dae: Dae, names: Collection[str]) -> Dae:
    """Return the DAE with the start values of some parameters in their place.

    Raises:
        UnknownName: The model has no such parameter.
    """
    known = {v.name: v for v in dae.parameters}
    for name in names:
        if name not in known:
            raise UnknownName.among(dae.full_name, "parameter", name, known)
    values = SX(dae.p)
    for i, parameter in enumerate(dae.parameters):
        if parameter.name in names:
            values[i] = parameter.start or 0.0
    return dae.rewritten(lambda laws: ca.substitute(laws, [dae.p], [values]))
