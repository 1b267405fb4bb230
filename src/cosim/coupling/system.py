"""`System`: parts, connections and start values; `couple` checks and builds one."""

import os
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import finalize

from casadi_models.dae import Dae
from casadi_models.dae.coupled import Connection, joined
from casadi_models.dae.variables import is_name
from casadi_models.units import Unit, conversion, parse_unit
from cosim.coupling.co_simulation import CoSimulation, Method, Settings
from cosim.errors import ParameterError, UnknownName, UsageError, naming_keywords
from cosim.fmi.archive import unpacked
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.instance import by_name, is_number, may_be_set, read_description, unit_of
from cosim.fmi.ssp import write_ssp
from cosim.fmi.units import units_for
from cosim.host.temporary import temporary_folder
from cosim.integrate.keywords import named, requested
from cosim.integrate.modes import hybrid
from cosim.memo import cached_per_thread
from cosim.model.quantities import quantity
from cosim.model.request import choice
from cosim.model.values import number, plain_values
from cosim.trajectory import Trajectory


@dataclass(frozen=True)
class Variable:
    """A variable of a part: its unit (None if the part does not name one) and what it may be.

    Attributes:
        name, unit: Name and unit.
        units: Definitions of units by name, with that of its own unit if there is one.
        is_input, is_source, is_start: Whether it can be driven, can drive, has a start value.
    """

    name: str
    unit: str | None
    is_input: bool
    is_source: bool
    is_start: bool
    units: Mapping[str, Unit] = field(default_factory=dict)

    @property
    def definition(self) -> Unit | None:
        """What the unit means; None if there is no unit, or nothing defines it."""
        return None if self.unit is None else self.units.get(self.unit) or parse_unit(self.unit)


@dataclass(frozen=True, eq=False)
class Part:
    """A part: a model, or the path of an FMU.

    Attributes:
        name: Of the part, an identifier.
        subject: The model or the file.
        variables: By name.
    """

    name: str
    subject: Dae | Path
    variables: dict[str, Variable]

    def variable(self, name: str) -> Variable:
        """Return a variable.

        Raises:
            UnknownName: The part has none of this name.
        """
        if name not in self.variables:
            raise UnknownName.among(f"part '{self.name}'", "variable", name, self.variables)
        return self.variables[name]


def part_of(name: str, subject: object, folder: Path) -> Part:
    """Return a part.

    Args:
        name: Of the part.
        subject: A `Dae`, the name of a model, "PATH.py:FUNCTION" or the path of an FMU; paths are
            relative to `folder`.

    Raises:
        UsageError: The name is no identifier, or the subject none of these.
        CosimError: The model or the file cannot be loaded.
    """
    if not is_name(name):
        raise UsageError(f"part {name!r}: use letters, digits and _ for the name of a part")
    if isinstance(subject, os.PathLike) or (isinstance(subject, str) and subject.endswith(".fmu")):
        path = folder / subject
        return Part(name, path, _of_fmu(path))
    if isinstance(subject, str):
        place, colon, function = subject.rpartition(".py:")
        subject = named(f"{folder / place}.py:{function}" if colon else subject)
    if not isinstance(subject, Dae):
        raise UsageError.of_type(f"part '{name}'", subject, "a model, its name, or an FMU file")
    return Part(name, subject, _of_model(subject))


@cached_per_thread(16)
def _of_model(dae: Dae) -> dict[str, Variable]:
    inputs = {v.name for v in dae.inputs}
    sources = {v.name for v in (*dae.states, *dae.algebraics, *dae.output_variables)}
    starts = inputs | {v.name for v in (*dae.states, *dae.parameters) if v.start is not None}
    starts |= {through.variable.name for through in dae.start_outputs}
    return {
        v.name: Variable(v.name, v.unit, v.name in inputs, v.name in sources, v.name in starts)
        for v in dae.variables
    }


def _of_fmu(path: Path) -> dict[str, Variable]:
    with unpacked(path) as folder:
        description = read_description(folder, path)
    if description.coSimulation is None:
        raise UsageError(f"{path} has no co-simulation; a part of a system needs it")
    found = {}
    for name, variable in by_name(description).items():
        continuous = variable.type in ("Real", "Float64") and is_number(variable)
        is_input = continuous and variable.causality == "input"
        source = continuous and variable.causality in ("output", "local")
        start = is_number(variable) and may_be_set(variable)
        units = units_for(variable, description)
        found[name] = Variable(name, unit_of(variable), is_input, source, start, units)
    return found


@dataclass(frozen=True, eq=False)
class System:
    """A coupled system; build one with `couple` or `read_ssp`.

    Attributes:
        name: An identifier.
        parts: By name, in the declared order.
        connections: Which output drives which input.
        start_values: By part and variable, in the variable's unit.
        stop_time, output_interval: s; those of the parts when None.
        title: One line.

    Example:
        >>> import cosim
        >>> system = cosim.couple({"shaft": "crank_shaft"}, {}, start_values={"shaft.omega": 3.0})
        >>> round(cosim.simulate(system.dae, stop_time=1).final["shaft.omega"], 6)
        13.0
    """

    name: str
    parts: Mapping[str, Part]
    connections: tuple[Connection, ...]
    start_values: dict[tuple[str, str], float]
    stop_time: float | None = None
    output_interval: float | None = None
    title: str = ""
    _open: ExitStack = field(default_factory=ExitStack, repr=False)

    def __repr__(self) -> str:
        lines = [f"{self.name}: {len(self.parts)} parts, {len(self.connections)} connections"]
        for name, part in self.parts.items():
            subject = part.subject
            lines.append(f"  {name}: {getattr(subject, 'full_name', subject.name)}")
        for wire in self.connections:
            lines.append(f"  {'.'.join(wire.output)} -> {'.'.join(wire.input)}")
        return "\n".join(lines)

    @property
    def fmus(self) -> list[Path]:
        """The files of those parts that are FMUs."""
        return [p.subject for p in self.parts.values() if isinstance(p.subject, Path)]

    @property
    def is_model(self) -> bool:
        """Whether all parts are models, so that `dae` exists."""
        return not self.fmus

    @cached_property
    def dae(self) -> Dae:
        """All parts as one model, whose variables are called `part.variable`.

        Connected inputs become outputs. A loop of direct feedthrough that is linear is solved; any
        other one becomes algebraic unknowns.

        Raises:
            UsageError: A part is an FMU, or a loop has no solution.
        """
        models = dict[str, Dae]()
        for name, part in self.parts.items():
            subject = part.subject
            if not isinstance(subject, Dae):
                raise UsageError(
                    f"{self.name}: part '{name}' is an FMU, whose equations are not known; "
                    "simulate the system by co-simulation (--method, or System.simulate)"
                )
            own = {v: value for (p, v), value in self.start_values.items() if p == name}
            models[name] = requested(subject, start_values=own).configured() if own else subject
        try:
            dae = joined(self.name, self.title, models, self.connections)
        except ValueError as error:
            raise UsageError(f"{self.name}: {error}") from None
        experiment = replace(
            dae.experiment,
            stop_time=self.stop_time or dae.experiment.stop_time,
            output_interval=self.output_interval or dae.experiment.output_interval,
        )
        return replace(dae, experiment=experiment)

    @naming_keywords
    def simulate(
        self,
        *,
        start_time: float = 0.0,
        stop_time: float | None = None,
        output_interval: float | None = None,
        accuracy: float | None = None,
        macro_step: float | None = None,
        method: str = Method.ITERATED,
        relative_tolerance: float | None = None,
        start_values: Mapping[str, float | str] | None = None,
        outputs: Sequence[str] | None = None,
        threads: bool = False,
    ) -> Trajectory:
        """Simulate the parts as FMUs for co-simulation. Binaries of FMUs run in this process.

        Args:
            start_time: Begin of the run, s.
            stop_time, output_interval: s; those of the system when None.
            accuracy: Desired largest error of the outputs that the coupling causes, in nominal
                values; the macro steps are chosen for it, and checked by a second run with
                others. 1e-6 if neither this nor `macro_step` is given.
            macro_step: Instead of `accuracy`, s; events end macro steps of the methods of order 4.
            method: "iterated" (default; order 4: macro steps are repeated until the inputs at
                their end agree with the outputs), "extrapolated" (order 4, without repetition),
                "gauss_seidel" or "jacobi" (order 1: inputs are constant within a macro step).
            relative_tolerance: Of the solvers in the parts; chosen for `accuracy` when None, and
                1e-10 with `macro_step`.
            start_values: Start values, parameters and constant inputs by `part.variable`: numbers
                in the variable's unit, or texts with a unit.
            outputs: Names to record, `part.variable`; all outputs and connected inputs when None.
            threads: Whether parts step at the same time, a thread each, with equal results; their
                FMUs must bear it. Not with gauss_seidel, nor on Windows.

        Returns:
            The recorded variables. Its `stats` holds macro_steps, rejected_steps, iterations,
            part_steps and order (by part), error_estimate where the run was checked, and with
            `macro_step`, if inputs are cubics, interface_error: the largest difference of inputs
            and outputs, in the sizes of the inputs, within macro steps and at their ends. If a
            part ends the run, it is complete, and stop and stop_time say which part, and when.

        Raises:
            UnknownName, UsageError, ParameterError: An argument is wrong.
            SolverError: A part failed, or a loop of direct feedthrough has no solution; `partial`
                is the run up to there.
            MissingTool: There is no compiler.
        """
        settings = Settings(
            *self.times(start_time, stop_time, output_interval),
            accuracy=_positive(self.name, "accuracy", accuracy),
            macro_step=_positive(self.name, "macro_step", macro_step),
            method=choice(Method, "method", method),
            tolerance=_positive(self.name, "relative_tolerance", relative_tolerance),
            threads=bool(threads),
        )
        values = self.start_values | _values(self.parts, start_values or {})
        wanted = None if outputs is None else [split_name(self.parts, name) for name in outputs]
        run = self._co_simulation.run(settings, self._of_parts(values), wanted)
        notes = [run.stats["note"]] if "note" in run.stats else []
        notes += [
            f"no file defines the unit '{unit}': {connection} is not converted"
            for unit, connection in _undefined_units(self.parts, self.connections).items()
        ]
        return replace(run, stats={**run.stats, "note": "; ".join(notes)}) if notes else run

    def write_ssp(self, target: str | os.PathLike[str]) -> Path:
        """Write the system with its FMUs as an SSP 1.0 file; models are exported as FMI 2.0.

        Raises:
            ExportError: The file cannot be written.
        """
        return write_ssp(
            target,
            self.files,
            [(".".join(w.output), ".".join(w.input)) for w in self.connections],
            values={
                f"{part}.{name}": value
                for part, values in self._of_parts(self.start_values).items()
                for name, value in values.items()
            },
            stop_time=self.stop_time,
            name=self.name,
        )

    def holds(self, resource: AbstractContextManager[Any]) -> None:
        """Keep what the parts need, such as unpacked files, as long as the system lives."""
        self._open.push(resource)
        finalize(self, self._open.close)

    @cached_property
    def files(self) -> dict[str, Path]:
        """FMUs of the parts by name; models are exported as FMI 2.0 to a temporary folder."""
        return self._exported(dict.fromkeys(self.parts, 2))

    def _exported(self, versions: Mapping[str, int]) -> dict[str, Path]:
        held = ExitStack()
        folder = Path(held.enter_context(temporary_folder()))
        self.holds(held)
        return {
            name: part.subject
            if isinstance(part.subject, Path)
            else export_fmu(part.subject, folder / f"{name}.fmu", fmi=versions[name], valid=False)
            for name, part in self.parts.items()
        }

    @cached_property
    def _co_simulation(self) -> CoSimulation:
        # events end macro steps by the event mode, which FMI 2.0 does not have
        versions = {
            n: 3 if isinstance(p.subject, Dae) and hybrid(p.subject) else 2
            for n, p in self.parts.items()
        }
        found = CoSimulation(self.name, self._exported(versions), self.connections)
        self.holds(closing(found))
        return found

    def _of_parts(self, values: Mapping[tuple[str, str], float]) -> dict[str, dict[str, float]]:
        """Return values by part, with the states whose starts outputs of models determine."""
        found = dict[str, dict[str, float]]()
        for name, part in self.parts.items():
            own = {variable: value for (owner, variable), value in values.items() if owner == name}
            dae = part.subject
            found[name] = plain_values(dae, own) if isinstance(dae, Dae) else own
        return found

    def times(
        self, start: float | None, stop: float | None, interval: float | None
    ) -> tuple[float, float, float]:
        """Return start, stop and output interval of a run, s, with those of the system for None."""
        daes = [p.subject.experiment for p in self.parts.values() if isinstance(p.subject, Dae)]
        start = number(self.name, "start_time", start or 0.0)
        if stop is None:
            stop = self.stop_time or max((e.stop_time for e in daes), default=1.0)
        stop = number(self.name, "stop_time", stop)
        if not stop > start:
            raise ParameterError(
                f"{self.name}: stop_time = {stop:g} s is not after start_time = {start:g} s"
            )
        if interval is None:
            interval = self.output_interval or min(
                (e.output_interval for e in daes), default=(stop - start) / 500
            )
        return start, stop, number(self.name, "output_interval", interval, positive=True)


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

    Raises:
        UnknownName: A part or a variable does not exist.
        UsageError: An input is connected twice or given a value as well, a variable is no input or
            no output, or the units do not fit.
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
    found = {n: part_of(n, subject, Path(folder)) for n, subject in parts.items()}
    wires = tuple(_connection(found, sink, source) for sink, source in connections.items())
    values = _values(found, start_values or {})
    for wire in wires:
        if wire.input in values:
            raise UsageError(f"{'.'.join(wire.input)} is connected and given a value; drop one")
    for what, time in (("stop_time", stop_time), ("output_interval", output_interval)):
        _positive(name, what, time)
    for n, part in found.items():
        if isinstance(part.subject, Dae):  # others feel the relations in what drives them
            driving = tuple(wire.output[1] for wire in wires if wire.output[0] == n)
            found[n] = replace(part, subject=replace(part.subject, driving=driving))
    return System(name, found, wires, values, stop_time, output_interval, title)


def split_name(parts: Mapping[str, Part], name: object) -> tuple[str, str]:
    """Return part and variable of "part.variable".

    Raises:
        UnknownName: There is no such part or variable.
    """
    part, dot, variable = str(name).partition(".")
    if not dot or part not in parts:
        raise UnknownName.among("the system", "part", part, parts)
    return part, parts[part].variable(variable).name


def _connection(parts: Mapping[str, Part], sink: str, source: str) -> Connection:
    ends = split_name(parts, sink), split_name(parts, source)
    driven, driving = (parts[part].variable(name) for part, name in ends)
    if not driven.is_input:
        inputs = [v.name for v in parts[ends[0][0]].variables.values() if v.is_input]
        raise UsageError(
            f"{sink} is no input; connect an input: {', '.join(inputs) or 'this part has none'}"
        )
    if not driving.is_source:
        raise UsageError(f"{source} is no output and no state; connect one that is")
    return Connection(*ends, *_conversion(sink, driven, source, driving))


def _conversion(sink: str, driven: Variable, source: str, driving: Variable) -> tuple[float, float]:
    """Return factor and offset from one unit to another; units without definition are equal."""
    of, to = driving.definition, driven.definition
    if of is None or to is None:
        return 1.0, 0.0
    try:
        return conversion(of, to)
    except ValueError as error:
        raise UsageError(
            f"{source} [{driving.unit}] cannot drive {sink} [{driven.unit}]: {error}"
        ) from error


def _undefined_units(
    parts: Mapping[str, Part], connections: Sequence[Connection]
) -> Mapping[str, str]:
    """Return the first connection of each unit without a definition, if both ends have units."""
    found = dict[str, str]()
    for wire in connections:
        ends = [parts[part].variable(name) for part, name in (wire.output, wire.input)]
        if None in (ends[0].unit, ends[1].unit) or ends[0].unit == ends[1].unit:
            continue
        for end in ends:
            if end.definition is None:
                text = f"{'.'.join(wire.output)} to {'.'.join(wire.input)}"
                found.setdefault(str(end.unit), text)
    return found


def _values(
    parts: Mapping[str, Part], given: Mapping[str, float | str]
) -> dict[tuple[str, str], float]:
    if not isinstance(given, Mapping):
        raise UsageError.of_type("start_values", given, "values by name, e.g. {'a.x': 1}")
    found = dict[tuple[str, str], float]()
    for name, value in given.items():
        key = split_name(parts, name)
        variable = parts[key[0]].variable(key[1])
        if not variable.is_start:
            raise UsageError(f"{name} cannot be given; it is calculated")
        if isinstance(value, str):
            value = quantity(name, value, variable.unit or "1", definitions=variable.units)
        found[key] = number(key[0], key[1], value)
    return found


def _positive(owner: str, name: str, value: float | None) -> float | None:
    return None if value is None else number(owner, name, value, positive=True)
