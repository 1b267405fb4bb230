"""fmuloader, with an FMU for co-simulation that is initialized."""

from typing import Any


def started(path: str, description: Any) -> tuple[Any, Any]:
    """Return an instance and its function that reads reals; of fmpy is only the description."""
    from fmuloader import fmi2, fmi3

    identifier = description.coSimulation.modelIdentifier
    if description.fmiVersion == "2.0":
        slave = fmi2.Fmi2Slave(path, model_identifier=identifier)
        kind = fmi2.Fmi2Type.CO_SIMULATION
        slave.instantiate("one", kind, guid=description.guid)
        slave.setup_experiment(start_time=0.0)
        read = slave.get_real
    else:
        slave = fmi3.Fmi3Slave(path, model_identifier=identifier)
        slave.instantiate_co_simulation("one", instantiation_token=description.guid)
        read = slave.get_float64
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    return slave, read
