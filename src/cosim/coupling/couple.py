"""`couple`: a system from parts, connections and start values, checked one by one."""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from casadi_models.dae import Dae
from casadi_models.dae.coupled import Connection
from cosim.coupling.opened_part import unused_abilities
from cosim.coupling.part import Part, connection_of, part_of, split_name
from cosim.coupling.system import System
from cosim.coupling.values import values_of
from cosim.errors import UsageError
from cosim.model.values import number

Within = Callable[..., AbstractContextManager[None]]


def couple(
    parts: Mapping[str, Any],
    connections: Mapping[str, str],
    *,
    start_values: Mapping[str, float | str] | None = None,
    name: str = "system",
    stop_time: float | None = None,
    output_interval: float | None = None,
    title: str = "",
    folder: str | os.PathLike[str] = ".",
    open_inputs: Sequence[str] = (),
    abilities: Mapping[str, str] | None = None,
) -> System:
    """Couple models and FMUs.

    Args:
        parts: By name: the name of a model, a `Dae`, "PATH.py:FUNCTION" or the path of an FMU.
        connections: "part.output" by "part.input"; units are converted.
        start_values: Start values, parameters and constant inputs by "part.variable": numbers in
            the variable's unit, or texts with a unit.
        name: Of the system, an identifier.
        stop_time, output_interval: Of its runs, s; those of the parts when None.
        title: One line about it.
        folder: What relative paths refer to.
        open_inputs: "part.input" of those that keep their start value; `cosim info` and runs name
            all other inputs that nothing drives.
        abilities: What not to use of a part, by its name, e.g. {"motor": "no rates, no rollback"}:
            "no interpolation" of inputs, "no rates" (derivatives of outputs), "no rollback",
            "no directional derivatives", "no event mode", "no co-simulation" (but model exchange).

    Raises:
        UnknownName: A part or a variable does not exist.
        UsageError: An input is connected twice, or given a value or declared open as well, a
            variable is no input or no output, or the units do not fit.
        ParameterError: A value is not finite, or its unit does not fit.
        CosimError: A model or an FMU cannot be loaded.

    Example:
        >>> import cosim
        >>> def mass(name):
        ...     model = cosim.Model(name)
        ...     x, v = model.state("x", "m", 1, "place"), model.state("v", "m/s", 0, "speed")
        ...     force = model.input("force", "N", 0, "force")
        ...     model.derivative(x, v)
        ...     model.derivative(v, force)
        ...     model.output("pull", "N", -x, "spring force")
        ...     return model.freeze()
        >>> wires = {"a.force": "b.pull", "b.force": "a.pull"}
        >>> run = couple({"a": mass("a"), "b": mass("b")}, wires).simulate(stop_time=1)
        >>> round(run.final["a.x"], 6)  # cos 1
        0.540302
    """
    if not isinstance(parts, Mapping) or not parts:
        raise UsageError.of_type("couple: parts", parts, "models or FMUs by name")
    return couple_within(
        parts,
        connections,
        start_values={} if start_values is None else start_values,
        open_inputs=open_inputs,
        abilities={} if abilities is None else abilities,
        folder=Path(folder),
        name=name,
        title=title,
        stop_time=stop_time,
        output_interval=output_interval,
    )


def couple_within(
    parts: Mapping[str, Any],
    connections: Mapping[str, str],
    *,
    start_values: Mapping[str, float | str],
    open_inputs: Sequence[str],
    abilities: Mapping[str, str],
    folder: Path,
    within: Within = lambda *_key, word=None: nullcontext(),
    **facts: Any,
) -> System:
    """Couple models and FMUs; see `couple`.

    Args:
        within: Returns a context for the checks of an entry, such as ("parts", "a"), which may add
            its place to messages.
        facts: Of the system: name, title, stop_time and output_interval.
    """
    found = dict[str, Part]()
    for name, subject in parts.items():
        with within("parts", name):
            found[name] = part_of(name, subject, folder)
    wires, driven = list[Connection](), set[tuple[str, str]]()
    for sink, source in connections.items():
        with within("connections", sink):
            wires.append(connection_of(found, sink, source))
            if wires[-1].input in driven:
                raise UsageError(f"{sink} is connected twice, by two of its names; drop one")
            driven.add(wires[-1].input)
    UsageError.reject("start_values", start_values, Mapping, "values by name, e.g. {'a.x': 1}")
    values = dict[tuple[str, str], float]()
    for name, value in start_values.items():
        with within("start_values", name):
            values |= values_of(found, {name: value}, {}, driven)
    opened = set[tuple[str, str]]()
    if isinstance(open_inputs, str):
        raise UsageError.of_type("open_inputs", open_inputs, 'a list, e.g. ["a.u"]')
    for name in open_inputs:
        with within("open_inputs", word=name):
            opened.add(_open_input(found, name, driven))
    with within("abilities"):
        unused = unused_abilities(found, abilities)
    more = {"open_inputs": frozenset(opened), "unused": unused}
    return system_of(found, wires, values, **more, **facts)


def system_of(
    parts: Mapping[str, Part],
    connections: Sequence[Connection],
    values: Mapping[tuple[str, str], float],
    **facts: Any,
) -> System:
    """Return a system of checked parts, connections and values.

    Args:
        facts: More attributes of `System`.

    Raises:
        ParameterError: A time is not positive and finite.
    """
    for time in ("stop_time", "output_interval"):
        if facts.get(time) is not None:
            later_start = time == "stop_time" and "start_time" in facts
            number(facts["name"], time, facts[time], positive=not later_start)
    found = dict(parts)
    for name, part in found.items():
        if isinstance(part.subject, Dae):  # others feel the relations in what drives them
            driving = tuple(wire.output[1] for wire in connections if wire.output[0] == name)
            found[name] = replace(part, subject=replace(part.subject, driving=driving))
    return System(parts=found, connections=tuple(connections), start_values=dict(values), **facts)


def _open_input(
    parts: Mapping[str, Part], name: object, driven: set[tuple[str, str]]
) -> tuple[str, str]:
    key = split_name(parts, name)
    if not parts[key[0]].variable(key[1]).is_input:
        raise UsageError(f"open_inputs: {name} is no input; name inputs only")
    if key in driven:
        raise UsageError(f"open_inputs: {name} is connected; drop one")
    return key
