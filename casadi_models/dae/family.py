"""What the formulations of one system have in common."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from casadi_models.dae.model import Model


@dataclass(frozen=True)
class Family:
    """A system that several formulations describe.

    Attributes:
        name: The system, a C identifier.
        description: What it is, in a few words.
        source: Book, unit and example, or a reference.
        display: Display unit by SI unit, for every variable that does not name its own.
        stop_time, output_interval: Of the run that the system is shown with, s.
        reference_tolerance: See `Experiment`.
        draw: Declares what all its formulations look like, by the names of variables.
    """

    name: str
    description: str
    source: str
    display: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    stop_time: float = 10.0
    output_interval: float = 0.01
    reference_tolerance: float = 1e-10
    draw: Callable[[Model], object] | None = None

    def formulation(self, name: str, description: str) -> Model:
        """Begin a formulation: `description` says which equations and which unknowns."""
        model = Model(
            self.name,
            name,
            description=f"{self.description}: {description}",
            source=self.source,
            display=self.display,
            stop_time=self.stop_time,
            output_interval=self.output_interval,
            reference_tolerance=self.reference_tolerance,
        )
        if self.draw is not None:
            self.draw(model)
        return model
