"""`OpenedFile`: an unpacked FMU for co-simulation that several sessions share."""

import os
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from weakref import finalize

from casadi_models.dae import Dae
from cosim.errors import FmuError
from cosim.fmi.archive import unpacked
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.arrays import with_elements
from cosim.fmi.run.description import Interface, choose_interface, read_description
from cosim.fmi.run.instance import instantiated
from cosim.fmi.trust import is_made_here
from cosim.host.temporary import temporary_folder
from cosim.memo import cached_per_thread


class OpenedFile:
    """An unpacked FMU; its files are removed when no session uses it any more.

    Args:
        path: Of the FMU.
        name: What messages call it; the path when None.

    Attributes:
        description: Of fmpy.
        is_own: Whether it was exported here, so that its reset is complete.

    Raises:
        FmuError, SecurityError: It is no FMU for co-simulation that can run here.
    """

    def __init__(self, path: str | os.PathLike[str], name: str | None = None) -> None:
        self.name = name or str(path)
        with ExitStack() as opening:
            self._folder = opening.enter_context(unpacked(path))
            self.description = with_elements(read_description(self._folder, path))
            if self.description.modelExchange and not self.description.coSimulation:
                raise FmuError(
                    f"{self.name} is for model exchange only; the solver of a system integrates "
                    f"it: cosim.open(cosim.couple({{'part': {str(path)!r}}}, {{}}))"
                )
            choose_interface(self._folder, self.description, Interface.CO_SIMULATION, path)
            self.is_own = is_made_here(path)
            finalize(self, opening.pop_all().close)

    def instance(self, stack: ExitStack) -> tuple[Any, Callable[[Exception], FmuError]]:
        """Return a new instance that a stack frees, and a function that explains its errors."""
        facts = self._folder, self.description, Interface.CO_SIMULATION, self.name
        return stack.enter_context(instantiated(*facts))


@cached_per_thread(8)
def exported(dae: Dae, solver: str | None) -> OpenedFile:
    """Return the FMU of a model, which is exported once."""
    with temporary_folder() as folder:
        path = export_fmu(dae, Path(folder) / "model.fmu", fmi=3, solver=solver)
        return OpenedFile(path, dae.full_name)
