"""The runs of a command line: complete, failed or interrupted."""

import argparse
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np

from casadi_models.dae import Dae
from cosim.api import execute, run_scene
from cosim.backend import Backend
from cosim.cli.arguments import (
    TIMES,
    assigned,
    laws_in,
    names_in,
    numbers_in,
    options_in,
    scene_from,
    start_texts,
    start_values_of_fmu,
)
from cosim.cli.tables import note
from cosim.coupling.files import coupling_report, is_system, read_system, simulate_file
from cosim.coupling.part import part_of
from cosim.coupling.system import System
from cosim.coupling.values import target
from cosim.errors import FmuError, Interrupted, ParameterError, SolverError, UsageError
from cosim.fmi.archive import with_places
from cosim.fmi.run.isolated import run_apart
from cosim.fmi.run.request import TIME
from cosim.fmi.run.typed_values import REALS, series_value
from cosim.fmi.trust import is_made_here, require_trust
from cosim.integrate.outputs import all_columns
from cosim.model.catalogue import loaded
from cosim.model.inputs import read_inputs
from cosim.model.quantities import quantity, reject_mixed_units
from cosim.model.request import RunRequest, choice
from cosim.scene.scene import Scene
from cosim.scene.variants import variant
from cosim.series.samples import times_within
from cosim.study.accuracy.choice import report
from cosim.text import MOST_NAMES, shortened
from cosim.trajectory import Column, Trajectory

_OF_MODELS = (
    *("backend", "solver", "absolute_tolerance", "step_size", "on_invalid", "drift_control"),
    *("max_step", "stop_when", "record_events", "accuracy", "budget"),
)
_NUMBER = re.compile(r"[-+.\deE]+")  # without a unit
_OF_FMUS = ("interface_type", "master")
_OF_SYSTEMS = ("method", "macro_step")


def scene_or_none(args: argparse.Namespace) -> Scene | None:
    """Return the scene of a command line; None for an FMU file and for a co-simulation."""
    if args.model.lower().endswith(".fmu"):
        return None
    has_method = any(value is not None for value in options_in(args, *_OF_SYSTEMS).values())
    if is_system(args.model):  # co-simulation, or all parts as one model
        system = read_system(args.model)
        _report_undriven_inputs(args, system)
        return None if has_method or not system.is_model else scene_from(args)
    scene = scene_from(args)  # which there may be none
    if has_method:
        raise UsageError("--method and --macro-step are for coupled systems")
    return scene


def _report_undriven_inputs(args: argparse.Namespace, system: System) -> None:
    """Name the inputs of a system that nothing drives, before it runs."""
    given = {*dict(start_texts(args)), *_inputs_in(args)}
    undriven = [name for name in system.undriven_inputs if name not in given]
    if undriven:
        note(
            args,
            f"note: {system.name}: nothing drives {shortened(undriven, MOST_NAMES)}; connect "
            f"{'it' if len(undriven) == 1 else 'them'}, give a value, or declare open_inputs",
        )


def run_or_partial(args: argparse.Namespace, scene: Scene | None) -> tuple[Trajectory, int]:
    """Return a run and its exit code; if the run failed, what was computed."""
    try:
        if scene is not None:
            _reject(args, _OF_FMUS, "FMU files; a model has --backend and --solver")
            run = run_scene(scene, Backend.NATIVE if args.backend is None else args.backend)
        else:
            run = _co_simulation(args) if is_system(args.model) else _fmu_run(args)
    except (SolverError, FmuError, Interrupted) as error:
        if not isinstance(error.partial, Trajectory) or not len(error.partial):
            raise
        if isinstance(error, Interrupted):
            print(error, file=sys.stderr)
            return error.partial, 130
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return error.partial, error.exit_code
    for text in run.stats.get("invalid", ()):
        print(f"warning: {run.model}: {text}", file=sys.stderr)
    if "note" in run.stats:
        note(args, f"note: {run.model}: {run.stats['note']}")
    if "macro_steps" in run.stats:
        note(args, coupling_report(run))
    elif "error_estimate" in run.stats:
        note(args, report(run))
    return run, 0


def _reject(args: argparse.Namespace, options: Iterable[str], what: str) -> None:
    """Reject options that are for something else."""
    for option in options:
        if getattr(args, option, None) is not None:
            raise UsageError(f"--{option.replace('_', '-')} is for {what}")


def _fmu_run(args: argparse.Namespace) -> Trajectory:
    """Run an FMU file in a process of its own."""
    _reject(args, _OF_MODELS, "models; an FMU has its own")
    settings = options_in(args, "timeout", *TIMES, "relative_tolerance")
    if getattr(args, "master", None) is not None:
        settings["master"] = args.master
    settings["start_values"] = start_values_of_fmu(args)
    require_trust(args.model, trusted=args.trust)
    run: Trajectory = run_apart(
        args.model,
        interface=args.interface_type,
        inputs=_inputs_in(args),
        outputs=None if args.outputs is None else names_in(args.outputs),
        **settings,
    )
    return run


def _inputs_in(args: argparse.Namespace) -> dict[str, Any]:
    """Return the inputs of an FMU or a system by name: formulas of time, and time series."""

    @cache
    def variable_of(name: str) -> Any:
        if args.model.lower().endswith(".fmu"):
            return part_of("fmu", args.model).variables.get(name)
        system = read_system(args.model)
        (part, own), *_ = target(system.parts, system.connectors, name).ends[0]
        return system.parts[part].variable(own)

    def number_of_word(name: str, cell: str) -> float | None:
        variable = variable_of(name)
        if variable is None or variable.type in REALS:
            return None
        return series_value(args.model, variable, cell)

    inputs: dict[str, Any] = dict(laws_in(args))
    if args.input_file is not None:
        series = read_inputs(args.input_file, words=number_of_word)
        if twice := inputs.keys() & set(series.names):
            raise UsageError(f"{min(twice)} has a formula and a column; give one of them")
        inputs |= dict.fromkeys(series.names, series)
    return inputs


def _co_simulation(args: argparse.Namespace) -> Trajectory:
    """Run a coupled system by co-simulation; in a process of its own if it has foreign FMUs."""
    others = [option for option in _OF_MODELS if option != "accuracy"]
    _reject(args, others, "models; a co-simulation has --method, --accuracy and --macro-step")
    names = (*TIMES, "relative_tolerance", "accuracy", *_OF_SYSTEMS)
    options = {name: value for name, value in options_in(args, *names).items() if value is not None}
    if "accuracy" in options:
        options["accuracy"] = quantity("--accuracy", options["accuracy"], "1")
    options["start_values"] = dict(start_texts(args))
    options["inputs"] = _inputs_in(args)
    options["outputs"] = None if args.outputs is None else names_in(args.outputs)
    system = read_system(args.model)
    if getattr(args, "at", None) is not None:  # before a run of which the times are not a part
        span = system.times(*(options.get(name) for name in TIMES))[:2]
        times_within(system.name, np.array(span), sorted(numbers_in("--at", args.at)))
    with system.naming_files():
        for file in system.fmus:
            require_trust(file, trusted=args.trust, name=with_places(file, system.places))
    if all(is_made_here(file) for file in system.fmus):
        return system.simulate(**options)
    own = {"timeout": args.timeout, "function": simulate_file}
    run: Trajectory = run_apart(args.model, **own, **options)
    return run


def runs_of(
    args: argparse.Namespace, *, everything: bool = False
) -> tuple[list[Trajectory], list[Scene | None], int]:
    """Run every source of a command line with every value of its lists, `-p NAME=A,B`.

    `everything` computes all outputs, also those that a scene does not name.

    Returns:
        The runs; the scene of each, None for an FMU file or a result; and the exit code.
    """
    runs: list[Trajectory] = []
    scenes: list[Scene | None] = []
    worst = 0
    for source in args.sources:
        if source.lower().endswith(".csv"):
            model = args.shown_model
            like = None if model is None else model_columns(loaded(model))
            runs.append(Trajectory.read_csv(source, like=like))
            scenes.append(None)
            continue
        for one in single(args, source):
            scene = scene_or_none(one)
            if everything and scene is not None:
                scene = Scene(scene.name, replace(scene.request, outputs=None), scene.title)
            names = (name for name in names_in(one.compare or "") if name)
            others = [_variant_of(scene, name, one.backend) for name in names]
            run, code = run_or_partial(one, scene)
            stats = {**run.stats, "variation": _with_units(one.variation, scene)}
            runs.append(replace(run, stats=stats) if one.variation else run)
            scenes.append(scene)
            for other, backend in others:
                runs.append(execute(other.reduced(), backend))
                scenes.append(scene)
            worst = max(worst, code)
    return runs, scenes, worst


def model_columns(dae: Dae) -> Trajectory:
    """Return an empty run with all variables of a model."""
    return _empty_run(dae.full_name, all_columns(dae))


def fmu_columns(path: str) -> Trajectory:
    """Return an empty run with all variables of an FMU that have a unit."""
    variables = part_of("fmu", path).variables.items()
    own = tuple(
        Column(n, v.unit, is_difference=v.is_difference)
        for n, v in variables
        if v.unit and n != TIME
    )
    return _empty_run(path, own)


def _empty_run(name: str, columns: tuple[Column, ...]) -> Trajectory:
    return Trajectory(name, np.empty(0), columns, np.empty((0, len(columns))))


def single(args: argparse.Namespace, source: str) -> Iterator[argparse.Namespace]:
    """Yield a command line of one source for every value of the lists of `-p`."""
    choices = []
    for item in args.values:
        name, equals, text = item.partition("=")
        texts = text.split(",") if equals else [text]
        reject_mixed_units(f"-p {name}", texts)
        choices.append([f"{name}{equals}{one}" for one in texts])
    lists = [i for i, items in enumerate(choices) if len(items) > 1]
    for chosen in product(*choices):
        variation = [chosen[i] for i in lists]
        changes = {"model": source, "values": list(chosen), "variation": variation}
        yield argparse.Namespace(**{**vars(args), **changes})


def _with_units(variation: Sequence[str], scene: Scene | None) -> str:
    """Return values such as `speed=3.5` as a label, with the unit of those without one."""
    dae = None if scene is None else scene.request.dae
    units = {} if dae is None else {v.name: v.unit for v in dae.variables if v.unit != "1"}
    parts = []
    for item in variation:
        name, _, text = item.partition("=")
        parts.append(f"{item} {units[name]}" if name in units and _NUMBER.fullmatch(text) else item)
    return ", ".join(parts)


def _variant_of(scene: Scene | None, name: str, first: str | None) -> tuple[RunRequest, Backend]:
    """Return request and backend of a run that `--compare` names.

    Solvers and formulations take over the backend of the first run.
    """
    if scene is None:
        raise UsageError("--compare is for models and scenes; an FMU has one backend only")
    other, backend = variant(scene.request, name)
    takes_over = first is not None and backend is Backend.NATIVE and name != backend
    return other, choice(Backend, "backend", first) if takes_over else backend


def size_of(args: argparse.Namespace) -> tuple[float, float]:
    """Return width and height of a picture, inches, from `--size WxH`."""
    width, cross, height = args.size.partition("x")
    if not cross:
        raise ParameterError(f"--size {args.size}: write WIDTHxHEIGHT in inches, e.g. 6.4x4.8")
    return quantity("--size", width, "1"), quantity("--size", height, "1")


def read_measured(args: argparse.Namespace, path: str, like: Trajectory | None) -> Trajectory:
    """Read a CSV file of measurements with the options of a command line.

    Args:
        args: The command line.
        path: The file.
        like: A run whose units and meanings apply to variables of the same names.
    """
    columns = dict(assigned("--column", args.columns, "HEADER"))
    return Trajectory.read_csv(
        path,
        columns=columns or None,
        time=args.time_column,
        time_offset=args.time_offset,
        like=like,
    )
