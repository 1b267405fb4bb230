"""What a DAE costs, counted before any second is measured."""

from dataclasses import dataclass

from casadi_models.dae import Dae


@dataclass(frozen=True)
class Size:
    """What a DAE costs: unknowns, and scalar operations of equations and outputs together."""

    states: int
    algebraics: int
    inputs: int
    parameters: int
    outputs: int
    operations: int


def size(dae: Dae) -> Size:
    """Count a DAE's variables, and its scalar operations with parameters being numbers."""
    return Size(
        len(dae.states),
        len(dae.algebraics),
        len(dae.inputs),
        len(dae.parameters),
        len(dae.output_variables),
        dae.operations(with_outputs=True),
    )
