"""`Backend`: whether a request is simulated natively or as an FMU; `run` executes it."""

from dataclasses import replace
from enum import StrEnum

from cosim.fmi.run.exported import run as run_as_fmu
from cosim.integrate.run import run as run_natively
from cosim.model.request import RunRequest
from cosim.trajectory import Trajectory


class Backend(StrEnum):
    """Native simulation, compiled or interpreted, or FMU simulation by one of two interfaces."""

    NATIVE = "native"
    INTERPRETED = "native-interpreted"
    MODEL_EXCHANGE = "fmu-me"
    CO_SIMULATION = "fmu-cs"

    @property
    def interface(self) -> str | None:
        """Name of the FMI interface; None for native simulation."""
        return _INTERFACES.get(self)

    @property
    def native(self) -> bool:
        """Whether the simulation is native, without an FMU."""
        return self.interface is None


_INTERFACES = {Backend.MODEL_EXCHANGE: "ModelExchange", Backend.CO_SIMULATION: "CoSimulation"}
FMU_BACKENDS = tuple(_INTERFACES)


def run(request: RunRequest, backend: Backend = Backend.NATIVE) -> Trajectory:
    """Execute a request on a backend."""
    if backend.interface is not None:
        return run_as_fmu(request, backend.interface)
    if backend is Backend.INTERPRETED:
        request = replace(request, policy=replace(request.policy, compiled=False))
    return run_natively(request)
