"""`Wiring`: the connected variables of opened parts, in the order of the C code."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from casadi_models.dae.coupled import Connection
from cosim.arrays import Integers, Vector
from cosim.coupling.opened_part import OpenedPart
from cosim.fmi.run.typed_values import is_continuous


@dataclass(frozen=True)
class Wiring:
    """The connected variables.

    Attributes:
        system: Name of the system.
        parts: By name, sorted, so that any order of them gives the same bits.
        turns: Their names in the declared order.
        connections: What drives what.
        unknown: Parts whose equations are not known.
    """

    system: str
    parts: Mapping[str, OpenedPart]
    turns: Sequence[str]
    connections: Sequence[Connection] = field(repr=False)
    unknown: Sequence[str] = ()

    @cached_property
    def inputs(self) -> list[tuple[str, str]]:
        """Part and variable of each input."""
        return [(name, v.name) for name, part in self.parts.items() for v in part.inputs]

    @cached_property
    def variables(self) -> list[Any]:
        """Variables of fmpy of the inputs."""
        return [v for part in self.parts.values() for v in part.inputs]

    @cached_property
    def _wires(self) -> list[Connection]:
        """The connection of each input."""
        driven = {wire.input: wire for wire in self.connections}
        return [driven[one] for one in self.inputs]

    @cached_property
    def sources(self) -> list[tuple[str, str]]:
        """Part and variable of the output that drives each input."""
        return [wire.output for wire in self._wires]

    @cached_property
    def source(self) -> Integers:
        """Number of the output that drives each input."""
        outputs = [(name, v.name) for name, part in self.parts.items() for v in part.outputs]
        return np.array([outputs.index(one) for one in self.sources], dtype=np.int64)

    @cached_property
    def factor(self) -> Vector:
        """Of each output in the input that it drives."""
        return np.array([wire.factor for wire in self._wires])

    @cached_property
    def offset(self) -> Vector:
        """Of each input."""
        return np.array([wire.offset for wire in self._wires])

    @cached_property
    def held(self) -> Integers:
        """Whether each input is constant between communication points, and one item more."""
        driving = [v for part in self.parts.values() for v in part.outputs]
        held = [
            not (is_continuous(v) and is_continuous(driving[source]))
            for v, source in zip(self.variables, self.source, strict=True)
        ]
        return np.array([*held, False], dtype=np.int64)

    @cached_property
    def feeds(self) -> Integers:
        """Whether each output depends at once on each input, (outputs, inputs)."""
        outputs = sum(len(part.outputs) for part in self.parts.values())
        feeds = np.zeros((outputs, len(self.inputs)), dtype=np.int64)
        row = column = 0
        for part in self.parts.values():
            block = part.feeds()
            end, right = row + block.shape[0], column + block.shape[1]
            feeds[row:end, column:right] = block
            row, column = end, right
        return feeds
