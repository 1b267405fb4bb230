"""`Backend`: whether a request is simulated natively or as an FMU."""

from enum import StrEnum


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
