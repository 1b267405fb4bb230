"""`System`: parts, connections and start values."""

import os
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from threading import RLock
from typing import Any, Unpack
from weakref import finalize

from casadi_models.dae import Dae
from casadi_models.dae.coupled import Connection
from cosim.coupling.co_simulation import CoSimulation
from cosim.coupling.connectors import Connector, with_outputs
from cosim.coupling.failures import EndlessEvents
from cosim.coupling.merged import Merged, one_model, sliding_parts, sticking_parts
from cosim.coupling.opened_part import Ability
from cosim.coupling.part import Part, free_name, split_key, split_name, undefined_units
from cosim.coupling.pickling import pickled, with_files
from cosim.coupling.settings import Method, Settings, positive
from cosim.coupling.signals import Signals
from cosim.coupling.values import values_of
from cosim.errors import Interrupted, ParameterError, SolverError, UsageError, naming_arguments_of
from cosim.fmi.archive import naming_places
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.description import Interface
from cosim.fmi.ssp import write_ssp
from cosim.fmi.units import change_of_units
from cosim.host.temporary import temporary_folder
from cosim.integrate.keywords import SpanKeywords, requested
from cosim.model.request import choice
from cosim.model.times import time_grid
from cosim.model.values import listed, number, plain_values
from cosim.text import MOST_NAMES, one_note, shortened
from cosim.trajectory import Trajectory


@naming_arguments_of
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
        start_time: Start of its runs, s.
        open_inputs: Inputs that are declared to keep their start value, by part and variable.
        connectors: Names of the whole system for variables of its parts, as an SSP file has them.
        places: What messages say for the temporary folders of files within a file.
        unused: Abilities of parts that are not used, by part.

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
    start_time: float = 0.0
    open_inputs: frozenset[tuple[str, str]] = frozenset()
    connectors: Mapping[str, Connector] = field(default_factory=dict)
    places: Mapping[str, str] = field(default_factory=dict, repr=False)
    unused: Mapping[str, tuple[Ability, ...]] = field(default_factory=dict)
    _open: ExitStack = field(default_factory=ExitStack, init=False, repr=False)
    _merged: dict[tuple[str, ...], "System"] = field(default_factory=dict, init=False, repr=False)
    _folders: list[Path] = field(default_factory=list, init=False, repr=False)
    _lock: RLock = field(default_factory=RLock, init=False, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        return pickled(self, self._folders)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(
            state["fields"], _open=ExitStack(), _merged={}, _folders=[], _lock=RLock()
        )
        if state["files"]:
            vars(self).update(parts=with_files(self.parts, state["files"], self._temporary()))

    def __repr__(self) -> str:
        lines = [f"{self.name}: {len(self.parts)} parts, {len(self.connections)} connections"]
        for name, part in self.parts.items():
            subject = getattr(part.subject, "full_name", part.subject.name)
            origin = f" ({part.origin})" if part.origin else ""
            lines.append(f"  {name}: {subject}{origin}")
        for wire in self.connections:
            lines.append(f"  {'.'.join(wire.output)} -> {'.'.join(wire.input)}")
        lines += [f"  {connector}" for connector in self.connectors.values()]
        if undriven := self.undriven_inputs:
            count = f"{len(undriven)} inputs: " if len(undriven) > MOST_NAMES else ""
            lines.append(f"  driven by nothing: {count}{shortened(undriven, MOST_NAMES)}")
        return "\n".join(lines)

    @property
    def driven(self) -> set[tuple[str, str]]:
        """Part and variable of the connected inputs."""
        return {wire.input for wire in self.connections}

    @property
    def undriven_inputs(self) -> list[str]:
        """Inputs without connection and start value that are not declared open either."""
        driven = self.driven | set(self.start_values) | self.open_inputs
        for connector in self.connectors.values():
            driven |= {end.variable for end in connector.ends}
        found = (
            (name, variable.name)
            for name, part in self.parts.items()
            for variable in part.variables.values()
            if variable.is_input
        )
        return [".".join(one) for one in dict.fromkeys(found) if one not in driven]

    @property
    def fmus(self) -> list[Path]:
        """The files of those parts that are FMUs."""
        return [p.subject for p in self.parts.values() if isinstance(p.subject, Path)]

    @property
    def is_model(self) -> bool:
        """Whether all parts are models, so that `dae` exists."""
        return bool(self.parts) and not self.fmus

    @cached_property
    def dae(self) -> Dae:
        """All parts as one model, whose variables are called `part.variable`.

        Connected inputs become outputs. A loop of direct feedthrough that is linear is solved; any
        other one becomes algebraic unknowns.

        Raises:
            UsageError: A part is an FMU, there are no parts, or a loop has no solution.
        """
        self._reject_no_parts()
        models = dict[str, Dae]()
        for name, part in self.parts.items():
            subject = part.subject
            if not isinstance(subject, Dae):
                raise UsageError(
                    f"{self.name}: part '{name}' is an FMU, whose equations are not known; "
                    "co-simulation runs it: cosim simulate, plot or tradeoff; System.simulate"
                )
            own = {v: value for (p, v), value in self.start_values.items() if p == name}
            models[name] = requested(subject, start_values=own).configured() if own else subject
        dae = one_model(self.name, self.title, models, self.connections)
        experiment = replace(
            dae.experiment,
            stop_time=self.stop_time or dae.experiment.stop_time,
            output_interval=self.output_interval or dae.experiment.output_interval,
        )
        return replace(dae, experiment=experiment)

    def simulate(
        self,
        *,
        accuracy: float | None = None,
        macro_step: float | None = None,
        method: str = Method.ITERATED,
        relative_tolerance: float | None = None,
        start_values: Mapping[str, float | str] | None = None,
        inputs: Any = None,
        outputs: Sequence[str] | None = None,
        threads: bool = False,
        **span: Unpack[SpanKeywords],
    ) -> Trajectory:
        """Simulate the parts as FMUs for co-simulation. Binaries of FMUs run in this process.

        Args:
            accuracy: Desired largest error of the outputs that the coupling causes, in nominal
                values; the macro steps are chosen for it, and checked by a second run with
                others. 1e-6 if neither this nor `macro_step` is given.
            macro_step: Instead of `accuracy`, s; events end macro steps of the methods of order 4.
                If the inputs grow, up to two runs with shorter ones check why.
            method: "iterated" (default; order 4: macro steps are repeated until the inputs at
                their end agree with the outputs), "extrapolated" (order 4, without repetition),
                "gauss_seidel" or "jacobi" (order 1: inputs are constant within a macro step).
            relative_tolerance: Of the solvers in the parts; chosen for `accuracy` when None, and
                1e-10 with `macro_step`.
            start_values: Start values, parameters and constant inputs by `part.variable`, or by
                the name of a connector: numbers in the variable's unit, or texts with a unit.
            inputs: Of parts or of the whole system, by name: a formula of time ("2*sin(3*t)"), a
                function of time, samples at the output times (n,), an `InputSeries`, or a number;
                or what `read_inputs` returns. Jumps and kinks end macro steps.
            outputs: Names to record, `part.variable` or an output of the whole system; all outputs
                and connected inputs when None.
            threads: Whether parts step at the same time, a thread each, with equal results; their
                FMUs must bear it. Not with gauss_seidel, nor on Windows.
            span: start_time, stop_time, output_interval, s; those of the system when None.

        Returns:
            The recorded variables. Its `stats` holds macro_steps, rejected_steps, iterations,
            part_steps and order (by part), error_estimate where the run was checked, and with
            `macro_step`, if inputs are cubics, interface_error: the largest difference of inputs
            and outputs, in the sizes of the inputs, at output times and as it is estimated for
            the middle of macro steps. If a
            part ends the run, it is complete, and stop and stop_time say which part, and when.
            undriven_inputs names inputs that kept their start value without being declared open.

        Raises:
            UnknownName, UsageError, ParameterError: An argument is wrong.
            SolverError: A part failed, a loop of direct feedthrough has no solution, or the method
                is unstable with `macro_step`; `partial` is the run up to there.
            MissingTool: There is no compiler.
        """
        settings = self.settings(
            accuracy=accuracy,
            macro_step=macro_step,
            method=method,
            relative_tolerance=relative_tolerance,
            threads=bool(threads),
            **span,
        )
        given = values_of(self.parts, start_values or {}, self.connectors, self.driven)
        if inputs is None or (isinstance(inputs, Mapping) and not inputs):
            return self._simulated(settings, given, outputs)
        times = time_grid(settings.start, settings.stop, settings.interval)
        signals = Signals.of(self.name, self.parts, self.connectors, inputs, times)
        try:
            run = self._driven_by(signals, given)._simulated(settings, given, outputs)
        except (SolverError, Interrupted) as error:
            if isinstance(error.partial, Trajectory):
                error.partial = signals.outside(error.partial)
            raise
        return signals.outside(run)

    def settings(
        self,
        *,
        accuracy: float | None,
        macro_step: float | None,
        method: str,
        relative_tolerance: float | None,
        threads: bool = False,
        **span: Unpack[SpanKeywords],
    ) -> Settings:
        """Return checked arguments of `simulate`."""
        self._reject_no_parts()
        return Settings(
            *self.times(span.get("start_time"), span.get("stop_time"), span.get("output_interval")),
            accuracy=positive(self.name, "accuracy", accuracy),
            macro_step=positive(self.name, "macro_step", macro_step),
            method=choice(Method, "method", method),
            tolerance=positive(self.name, "relative_tolerance", relative_tolerance),
            threads=threads,
        )

    def _driven_by(self, signals: Signals, given: Mapping[tuple[str, str], float]) -> "System":
        """Return the system with a part that drives inputs."""
        taken = self.driven | set(given)
        driven = {wire.input for wire in signals.connections}
        if twice := [".".join(name) for name in sorted(driven & taken)]:
            raise UsageError(f"{self.name}: {twice[0]} is connected or has a value; give it once")
        own = {(signals.name, name) for name in signals.part.variables}
        return replace(
            self,
            parts={**self.parts, signals.name: signals.part},
            connections=(*self.connections, *signals.connections),
            start_values={n: v for n, v in self.start_values.items() if n not in driven},
            open_inputs=self.open_inputs | own,
        )

    def _simulated(
        self,
        settings: Settings,
        given: dict[tuple[str, str], float],
        outputs: Sequence[str] | None,
    ) -> Trajectory:
        """Simulate by co-simulation; see `simulate`."""
        names = None if outputs is None else self._resolved(outputs)
        with self.naming_files(), self._lock:  # which owns the instances of the parts
            try:
                run = self._run(settings, given, self._recorded(names))
            except (SolverError, Interrupted) as error:
                if isinstance(error.partial, Trajectory):
                    error.partial = with_outputs(error.partial, self.connectors, names)
                raise
        if undriven := [name for name in self.undriven_inputs if split_key(name) not in given]:
            run = replace(run, stats={**run.stats, "undriven_inputs": undriven})
        notes = (
            f"no file defines the unit '{unit}': {connection} is not converted"
            for unit, connection in undefined_units(self.parts, self.connections).items()
        )
        if note := one_note(run.stats.get("note"), *notes):
            run = replace(run, stats={**run.stats, "note": note})
        return with_outputs(run, self.connectors, names)

    def _reject_no_parts(self) -> None:
        if not self.parts:
            raise UsageError(f"{self.name} has no parts; there is nothing to simulate")

    def _resolved(self, outputs: Sequence[str]) -> list[str]:
        """Return names of outputs as a run has them; a variable of a part may have several.

        The name of an array stands for its elements.
        """
        own = {connector.name for connector in self.connectors.values() if connector.shows}
        found = list[str]()
        for name in listed(f"{self.name}: outputs", outputs):
            if name in own:
                found.append(name)
                continue
            part, variable = split_name(self.parts, name)
            numbers = self.parts[part].numbers(variable)
            if not numbers:
                raise UsageError(f"{name} is not a single number and cannot be recorded")
            found += [f"{part}.{number}" for number in numbers]
        return found

    def _run(
        self,
        settings: Settings,
        given: dict[tuple[str, str], float],
        recorded: Sequence[tuple[str, str]],
    ) -> Trajectory:
        """Simulate; parts that slide on each other become one part."""
        values = self._of_parts(self.start_values | given)
        try:
            return self._co_simulation.run(settings, values, recorded)
        except EndlessEvents as error:
            names = sliding_parts(self.parts, self.connections, error.part)
            with suppress(SolverError, UsageError):
                if names:
                    return self._run_merged(names, settings, given, recorded)
            if not error.partial.complete:
                raise error from None
        return self._co_simulation.run(replace(settings, merges=False), values, recorded)

    def _run_merged(
        self,
        names: tuple[str, ...],
        settings: Settings,
        given: dict[tuple[str, str], float],
        recorded: Sequence[tuple[str, str]],
    ) -> Trajectory:
        merged = Merged(names, free_name(self.parts, "_".join(names)))
        if names not in self._merged:
            own = merged.changes(self.parts, self.connections, self.start_values, self.unused)
            self._merged[names] = System(self.name, **own)
        inside = {merged.inside(name): value for name, value in given.items()}
        try:
            run = self._merged[names]._run(settings, inside, list(map(merged.inside, recorded)))
        except Interrupted as error:
            if isinstance(error.partial, Trajectory):
                error.partial = merged.outside(error.partial, recorded)
            raise
        return merged.outside(run, recorded)

    def _recorded(self, names: Sequence[str] | None) -> list[tuple[str, str]]:
        """Return the variables of parts that names, or by default all outputs, need."""
        behind = {c.name: c.ends[0].variable for c in self.connectors.values() if c.shows}
        if names is not None:
            return list(dict.fromkeys(behind.get(name, split_key(name)) for name in names))
        return list(dict.fromkeys([*self._co_simulation.recorded, *behind.values()]))

    def naming_files(self) -> AbstractContextManager[None]:
        """Return a context in which messages about unpacked files name what they come from."""
        return naming_places(self.places)

    def write_ssp(self, target: str | os.PathLike[str]) -> Path:
        """Write the system with its FMUs as an SSP 1.0 file; models are exported as FMI 2.0.

        Raises:
            ExportError: The file cannot be written.
        """
        exposed = {end.variable for c in self.connectors.values() if c.is_input for end in c.ends}
        values = self._of_parts(self.start_values)
        inputs = {key for key in exposed if self.parts[key[0]].variable(key[1]).is_input}
        files: dict[str, Any] = {**self.files}
        for name, unused in self.unused.items():
            if Ability.CO_SIMULATION in unused:
                files[name] = files[name], Interface.MODEL_EXCHANGE
        return write_ssp(
            target,
            files,
            [(".".join(w.output), ".".join(w.input)) for w in self.connections],
            values={
                f"{part}.{name}": value
                for part, own in values.items()
                for name, value in own.items()
            },
            start_time=self.start_time,
            stop_time=self.stop_time,
            name=self.name,
            open_inputs=[".".join(key) for key in sorted(self.open_inputs | inputs)],
            transformations={
                ".".join(wire.input): (wire.factor, wire.offset)
                for wire in self.connections
                if (wire.factor, wire.offset) != self._change_of_units(wire)
            },
        )

    def _change_of_units(self, wire: Connection) -> tuple[float, float]:
        sink, source = (self.parts[part].variable(name) for part, name in (wire.input, wire.output))
        return change_of_units(sink.name, sink.measured, source.name, source.measured)

    def holds(self, resource: AbstractContextManager[Any], *folders: Path) -> None:
        """Keep what the parts need, such as unpacked files, as long as the system lives.

        Args:
            resource: Closed with the system.
            folders: Where files of parts are that are removed with the resource.
        """
        self._open.push(resource)
        finalize(self, self._open.close)
        self._folders.extend(folders)

    def _temporary(self) -> Path:
        """Return a new folder that is removed with the system."""
        held = ExitStack()
        folder = Path(held.enter_context(temporary_folder()))
        self.holds(held, folder)
        return folder

    @cached_property
    def files(self) -> dict[str, Path]:
        """FMUs of the parts by name; models are exported as FMI 2.0 to a temporary folder."""
        return self._exported(dict.fromkeys(self.parts, 2))

    def _exported(self, versions: Mapping[str, int]) -> dict[str, Path]:
        folder = self._temporary()
        return {
            name: part.subject
            if isinstance(part.subject, Path)
            else export_fmu(part.subject, folder / f"{name}.fmu", fmi=versions[name], valid=False)
            for name, part in self.parts.items()
        }

    @cached_property
    def _co_simulation(self) -> CoSimulation:
        found = self.instances()
        self.holds(closing(found))
        return found

    @cached_property
    def _files_to_run(self) -> dict[str, Path]:
        return self._exported({name: p.version_to_run for name, p in self.parts.items()})

    def instances(self) -> CoSimulation:
        """Return new instances of the parts; whoever asks for them closes them."""
        with self.naming_files(), self._lock:
            files = self._files_to_run
            unknown = [n for n, part in self.parts.items() if isinstance(part.subject, Path)]
            sticking = sticking_parts(self.parts, self.connections)
            return CoSimulation(self.name, files, self.connections, self.unused, unknown, sticking)

    def values_of_parts(self, given: Mapping[str, Any]) -> dict[str, dict[str, float]]:
        """Return the start values of the system and others, checked, by part, by variable.

        Args:
            given: Values by `part.variable` or by the name of a connector.
        """
        own = values_of(self.parts, given, self.connectors, self.driven)
        return self._of_parts(self.start_values | own)

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
        start = number(self.name, "start_time", self.start_time if start is None else start)
        if stop is None:
            stop = self.stop_time
        if stop is None:
            stop = max((e.stop_time for e in daes), default=start + 1.0)
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
