"""`Signals`: a part of a system that drives inputs by formulas of time and tables."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Model
from casadi_models.dae.coupled import Connection
from casadi_models.units import Unit, parse_unit
from cosim.arrays import Vector
from cosim.coupling.connectors import Connector, End
from cosim.coupling.part import Part, Variable, free_name, part_of
from cosim.coupling.values import target
from cosim.errors import UsageError
from cosim.fmi.run.typed_values import is_continuous, series_value
from cosim.integrate.keywords import requested
from cosim.model.driving import constant_of, driven, with_held, with_laws
from cosim.model.inputs import InputSeries
from cosim.model.quantities import quantity
from cosim.model.values import number
from cosim.trajectory import Trajectory

_NEVER = 1e300  # s


@dataclass(frozen=True)
class Signals:
    """The part, and what it drives.

    Attributes:
        name: Of the part.
        part: The part.
        connections: From its outputs to the inputs that they drive.
    """

    name: str
    part: Part
    connections: tuple[Connection, ...]

    @classmethod
    def of(
        cls,
        owner: str,
        parts: Mapping[str, Part],
        connectors: Mapping[str, Connector],
        inputs: Any,
        times: Vector,
    ) -> "Signals":
        """Return the part for inputs of a system.

        Args:
            owner: Name of the system.
            parts, connectors: Of the system.
            inputs: See `System.simulate`.
            times: Output times, s, (n,).

        Raises:
            UnknownName, UsageError, ParameterError: A variable is no input, or a formula or a table
                is malformed.
        """
        if isinstance(inputs, InputSeries):
            inputs = dict.fromkeys(inputs.names, inputs)
        elif not isinstance(inputs, Mapping):
            expected = "what cosim.read_inputs returns, or values by name, e.g. {'a.u': 'sin(t)'}"
            raise UsageError.of_type(f"{owner}: inputs", inputs, expected)
        name = free_name(parts, "inputs")
        model = Model("inputs", description="inputs of a system", source="formulas and tables")
        laws, wires = dict[str, Any](), list[Connection]()
        held = dict[str, Callable[[Any], float]]()
        for text, law in inputs.items():
            unit, units, ends = _driven(owner, parts, connectors, text)
            switched = [
                (end, variable)
                for end in ends
                if not is_continuous(variable := parts[end.variable[0]].variable(end.variable[1]))
            ]
            if switched:
                held[text] = partial(_number_for, owner, switched)
            constant = None if switched else constant_of(text, law, unit, units)
            unit = unit if parse_unit(unit) else "1"
            symbol = model.input(f"u{len(laws)}", unit, 0.0, text)
            model.output(f"y{len(laws)}", unit, symbol, text)
            laws[text] = law if constant is None else constant
            source = name, f"{text}_signal"
            wires += [Connection(end.variable, source, end.factor, end.offset) for end in ends]
        dae = model.freeze()  # whose names are no identifiers, but those of messages
        inputs_of, outputs = (
            tuple(replace(v, name=f"{text}{end}") for v, text in zip(own, laws, strict=True))
            for own, end in ((dae.inputs, ""), (dae.output_variables, "_signal"))
        )
        observed = tuple(v.name for v in outputs)
        dae = replace(dae, inputs=inputs_of, output_variables=outputs, observed=observed)
        dae = _following(dae, with_held(owner, laws, times, held), times)
        dae = replace(dae, driving=tuple(v.name for v in dae.output_variables))
        return cls(name, part_of(name, dae), tuple(wires))

    def outside(self, run: Trajectory) -> Trajectory:
        """Return a run without the variables and events of this part."""
        prefix = f"{self.name}."
        names = [name for name in run.names if not name.startswith(prefix)]
        events = tuple(e for e in run.events if not e.name.startswith(f"{self.name}: "))
        return replace(run.select(names), events=events)


def _driven(
    owner: str, parts: Mapping[str, Part], connectors: Mapping[str, Connector], name: str
) -> tuple[str, Mapping[str, Unit], tuple[End, ...]]:
    """Return the unit of an input of a system or of a part, units of its file, and what it sets."""
    _, ends, unit, units = target(parts, connectors, name)
    for part, own in (end.variable for end in ends):
        variable = parts[part].variable(own)
        if not variable.is_input:
            raise UsageError(f"{owner}: {name} is no input; formulas and tables drive inputs")
    return unit or "1", units, ends


def _number_for(owner: str, ends: Sequence[tuple[End, Variable]], value: object) -> float:
    """Return the number of a value, if each of the variables that it sets can have its own."""
    first = next((variable for end, variable in ends if end.is_same), None)
    if isinstance(value, str) and first is not None:
        given = series_value(owner, first, value)
    elif isinstance(value, str):
        given = quantity(owner, value, "1")
    else:
        given = float(value) if isinstance(value, bool) else number(owner, ends[0][1].name, value)
    for end, variable in ends:
        series_value(owner, variable, end.factor * given + end.offset)
    return given


def _following(dae: Dae, inputs: Mapping[str, Any], times: Vector) -> Dae:
    """Return the model whose inputs follow formulas, functions and tables."""
    found = driven(dae, inputs, lambda: times)
    dae, series = found.dae, found.series
    if series is not None:
        dae = _with_tables(dae, series)
    return requested(dae, start_values=found.constants).configured() if found.constants else dae


def _with_tables(dae: Dae, series: InputSeries) -> Dae:
    """Return what `driving.with_tables` does, with a few relations however many samples there are.

    It is for equations without validity conditions, in which relations of time are no events.
    """
    lines = zip(series.names, _lines_through(series, dae.t), strict=True)
    return with_laws(dae, tuple((name, partial(_as_it_is, line)) for name, line in lines))


def _as_it_is(line: SX, _: SX) -> SX:
    return line


def _lines_through(series: InputSeries, t: SX) -> list[SX]:
    """Return the lines between samples as expressions of time, one for each column.

    A relation for each digit finds the number of samples that have been, of which the tables of
    their ends, and of values and slopes, are functions. It jumps, so that their slopes are 0. The
    digits are those of a Gray code: one changes at a sample.
    """
    flat = (np.diff(series.values, axis=0) == 0).all(axis=1)
    needed = ~np.concatenate(([False], flat[1:] & flat[:-1], [False]))
    time, values = series.time[needed], series.values[needed]
    n, m = values.shape
    gaps = np.diff(time)[:, None]
    slopes = np.divide(np.diff(values, axis=0), gaps, out=np.zeros((n - 1, m)), where=gaps > 0)
    slopes = np.pad(slopes, ((1, 1), (0, 0)))  # before the first sample, and after the last one
    last = [0, *range(n)]  # the sample that was last, for each number of them
    number, sign, digit = SX(0), SX(1), 1 << n.bit_length()
    ends = _table("ends", np.append(time, _NEVER)[:, None], digit)
    rows = _table("rows", np.column_stack((time[last], values[last], slopes)), digit)
    while digit := digit // 2:
        ahead = sign * (t - ends(number + digit - 1))
        passed = (1 - sign) / 2 + sign * (ahead >= 0)
        number, sign = number + digit * passed, 1 - 2 * passed
    row = rows(number)
    return [row[1 + i] + row[1 + m + i] * (t - row[0]) for i in range(m)]


def _table(name: str, rows: Vector, size: int) -> ca.Function:
    """Return the rows (n, m) as a function of their number; the last one stands for all others."""
    every = np.pad(rows, ((0, size - len(rows)), (0, 0)), mode="edge")
    numbers, options = list(range(size)), {"lookup_mode": ["exact"]}
    return ca.interpolant(name, "linear", [numbers], every.ravel().tolist(), options)
