"""Road two: an FMU through fmpy to a `Trajectory`."""

import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath
from time import perf_counter
from typing import Any

import numpy as np

from cosim import fmpy_inputs
from cosim.errors import FmuError, SecurityError, UnknownName, UsageError
from cosim.inputs import InputSeries
from cosim.trajectory import Column, Trajectory
from cosim.values import number

INTERFACES = ("ModelExchange", "CoSimulation")
MOST_BYTES = 2**30  # of an unpacked FMU


def simulate_fmu(
    path: str | os.PathLike[str],
    *,
    interface: str | None = None,
    start_time: float | None = None,
    stop_time: float | None = None,
    output_interval: float | None = None,
    relative_tolerance: float | None = None,
    start: Mapping[str, float] | None = None,
    inputs: InputSeries | None = None,
    outputs: Sequence[str] | None = None,
) -> Trajectory:
    """Simulate an FMU with fmpy.

    Args:
        path: The FMU.
        interface: "ModelExchange" (fmpy's CVODE integrates) or "CoSimulation" (the solver inside
            does); what fmpy takes when None: co-simulation where the FMU has it.
        start_time, stop_time, output_interval: s; the FMU's default experiment when None.
        relative_tolerance: Error per step; the FMU's default experiment when None.
        start: Start values, parameters and constant inputs by name, in the FMU's units.
        inputs: Time series of some inputs, in the FMU's units.
        outputs: Names to record; the FMU's outputs when None.

    Returns:
        Every recorded variable, with its unit.

    Raises:
        FmuError: The file is no FMU that can run here, or the run failed.
        SecurityError: The archive would write outside its folder.
        UnknownName: A variable or the interface does not exist.
    """
    began = perf_counter()
    with unpacked(path) as folder:
        description = _read(folder, path)
        kind = _interface(description, interface, path)
        variables = {variable.name: variable for variable in description.modelVariables}
        values = _start_values(path, variables, start or {})
        names = _recorded(path, variables, outputs)
        log: list[str] = []
        instance = _instantiate(folder, description, kind, log, path)
        calls = _counted(instance) if kind == "ModelExchange" else None
        table = _driven(path, instance, description, kind, inputs, start_time, values)
        result = _simulated(
            path,
            log,
            filename=str(folder),
            model_description=description,
            fmu_instance=instance,
            fmi_type=kind,
            validate=False,
            start_time=start_time,
            stop_time=stop_time,
            output_interval=output_interval,
            relative_tolerance=relative_tolerance,
            start_values=values,
            input=table,
            output=names,
            record_events=False,
        )
    columns = tuple(_column(variables[name]) for name in names)
    rows = np.column_stack([result[name].astype(float) for name in names])
    stats: dict[str, Any] = {"solver": f"fmpy {kind}", "wall_time": perf_counter() - began}
    if calls is not None:
        stats["rhs_calls"] = calls[0]
    time = np.array(result["time"], dtype=float)
    run = Trajectory(description.modelName, time, columns, rows, stats)
    return _checked(run, description, stop_time, path, log)


@contextmanager
def unpacked(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Unpack an FMU into a folder that is gone afterwards.

    Raises:
        FmuError: The file is missing or no archive.
        SecurityError: An entry would lie outside the folder, or the content is too large.
    """
    try:
        archive = zipfile.ZipFile(path)
    except (OSError, zipfile.BadZipFile) as error:
        reason = getattr(error, "strerror", None) or "it is not a zip archive"
        raise FmuError(f"cannot read {path}: {reason}; give an FMU") from error
    with archive, tempfile.TemporaryDirectory(prefix="cosim-") as folder:
        _refuse_dangerous(archive, path)
        try:
            archive.extractall(folder)
        except (OSError, zipfile.BadZipFile, RuntimeError) as error:
            raise FmuError(f"cannot unpack {path}: {error}") from error
        yield Path(folder).resolve()


def _refuse_dangerous(archive: zipfile.ZipFile, path: object) -> None:
    seen: set[str] = set()
    for entry in archive.infolist():
        name = entry.filename
        windows = PureWindowsPath(name)
        outside = ".." in PurePosixPath(name).parts or ".." in windows.parts
        if outside or name.startswith(("/", "\\")) or windows.drive or "\0" in name:
            raise SecurityError(f"{path}: entry '{name}' lies outside the archive; do not use it")
        if (entry.external_attr >> 16) & 0o170000 == 0o120000:
            raise SecurityError(f"{path}: entry '{name}' is a link; do not use this file")
        if name.lower() in seen:
            raise SecurityError(f"{path}: entry '{name}' occurs twice; do not use this file")
        seen.add(name.lower())
    size = sum(entry.file_size for entry in archive.infolist())
    if size > MOST_BYTES:
        raise SecurityError(f"{path}: unpacks to {size:.3g} bytes, more than {MOST_BYTES}")


def _read(folder: Path, path: object) -> Any:
    from fmpy import read_model_description

    try:
        return read_model_description(str(folder), validate=False)
    except Exception as error:
        raise FmuError(f"{path}: modelDescription.xml cannot be read: {error}") from error


def _interface(description: Any, wanted: str | None, path: object) -> str:
    has = {"ModelExchange": description.modelExchange, "CoSimulation": description.coSimulation}
    if wanted is not None and wanted not in INTERFACES:
        raise UnknownName.among("cosim", "interface", wanted, INTERFACES)
    kind = wanted or ("CoSimulation" if has["CoSimulation"] else "ModelExchange")
    if not has[kind]:
        other = next((name for name in INTERFACES if has[name]), "neither")
        raise FmuError(f"{path} has no {kind} interface; it has {other}")
    identifier = has[kind].modelIdentifier
    if not identifier.isidentifier():
        raise SecurityError(f"{path}: modelIdentifier '{identifier}' is no C name")
    return kind


def _start_values(
    path: object, variables: Mapping[str, Any], start: Mapping[str, float]
) -> dict[str, float]:
    settable = [v.name for v in variables.values() if v.start is not None]
    for name in start:
        if name not in variables:
            raise UnknownName.among(str(path), "start value", name, settable)
        if name not in settable:
            raise UsageError(f"{path}: {name} is calculated and cannot be set")
    return {name: number(str(path), name, value) for name, value in start.items()}


def _recorded(
    path: object, variables: Mapping[str, Any], outputs: Sequence[str] | None
) -> list[str]:
    if outputs is None:
        return [name for name, v in variables.items() if v.causality == "output"]
    for name in outputs:
        if name not in variables:
            raise UnknownName.among(str(path), "output", name, variables)
    return list(outputs)


def _instantiate(folder: Path, description: Any, kind: str, log: list[str], path: object) -> Any:
    from fmpy import instantiate_fmu

    def collect(_environment: Any, _instance: Any, _status: Any, category: Any, text: Any) -> None:
        words = text.decode(errors="replace") if isinstance(text, bytes) else str(text)
        log.append(words)

    try:
        return instantiate_fmu(
            str(folder),
            description,
            kind,
            debug_logging=False,
            logger=_logger(description, collect),
        )
    except Exception as error:
        raise FmuError(f"{path} cannot be instantiated: {_tail(error, log)}") from error


def _logger(description: Any, collect: Any) -> Any:
    """Wrap a Python function as the log callback of the FMU's version."""
    if description.fmiVersion.startswith("2"):
        from fmpy.fmi2 import fmi2CallbackLoggerTYPE

        return fmi2CallbackLoggerTYPE(collect)
    return None


def _counted(instance: Any) -> list[int]:
    """Count the evaluations of the derivatives."""
    calls = [0]
    name = (
        "getDerivatives" if hasattr(instance, "getDerivatives") else "getContinuousStateDerivatives"
    )
    original = getattr(instance, name)

    def counted(*arguments: Any) -> Any:
        calls[0] += 1
        return original(*arguments)

    setattr(instance, name, counted)
    return calls


def _driven(
    path: object,
    instance: Any,
    description: Any,
    kind: str,
    series: InputSeries | None,
    start_time: float | None,
    values: dict[str, float],
) -> Any:
    """Put a series in charge of the inputs; add their start values; return fmpy's `input`."""
    if series is None:
        return None
    known = {v.name: v for v in description.modelVariables if v.causality == "input"}
    for name in series.names:
        if name not in known:
            raise UnknownName.among(str(path), "input", name, known)
    references = [known[name].valueReference for name in series.names]
    experiment = description.defaultExperiment
    default = experiment.startTime if experiment and experiment.startTime is not None else 0.0
    at_start = float(default) if start_time is None else start_time
    values |= fmpy_inputs.start_values(series, at_start)
    if kind == "CoSimulation":
        fmpy_inputs.drive_co_simulation(instance, series, references, description.coSimulation)
        return None
    constants = {
        name: values.get(name, float(variable.start or 0.0))
        for name, variable in known.items()
        if name not in series.names
    }
    return fmpy_inputs.drive_model_exchange(instance, series, references, constants)


def _simulated(path: object, log: list[str], **arguments: Any) -> Any:
    from fmpy import simulate_fmu as run

    instance = arguments["fmu_instance"]
    try:
        return run(**arguments)
    except Exception as error:
        raise FmuError(f"{path}: the run failed: {_tail(error, log)}") from error
    finally:
        instance.freeInstance()


def _tail(error: Exception, log: list[str]) -> str:
    return "; ".join([str(error), *dict.fromkeys(log[-3:])])


def _checked(
    run: Trajectory, description: Any, stop_time: float | None, path: object, log: list[str]
) -> Trajectory:
    finite = np.isfinite(run.values).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        name = run.names[int(np.argmin(np.isfinite(run.values[first])))]
        raise FmuError(f"{path}: {name} is not finite at {run.time[first]:g} s")
    experiment = description.defaultExperiment
    stop = stop_time
    if stop is None and experiment is not None and experiment.stopTime is not None:
        stop = float(experiment.stopTime)
    if stop is not None and run.time[-1] < stop - 1e-6 * max(1.0, abs(stop)):
        why = f": {log[-1]}" if log else ""
        raise FmuError(f"{path}: the run ended at {run.time[-1]:g} s, before {stop:g} s{why}")
    return run


def _column(variable: Any) -> Column:
    declared = variable.declaredType
    return Column(
        variable.name,
        variable.unit or (declared.unit if declared else None) or "1",
        variable.displayUnit,
        float(variable.nominal or 1.0),
        variable.description or "",
    )
