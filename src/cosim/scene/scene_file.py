"""`read_scene`: from a TOML file to a `Scene`; what is wrong in it is named with its line."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from casadi_models.dae import Dae, Variable
from cosim.errors import UnknownName, UsageError
from cosim.integrate.solver import Tolerance
from cosim.integrate.solvers import SOLVERS
from cosim.model.catalogue import load, no_such_output, observable
from cosim.model.inputs import InputSeries, read_inputs
from cosim.model.quantities import quantity
from cosim.model.values import checked, number
from cosim.scene.goals import GOALS
from cosim.scene.library import shipped_scenes
from cosim.scene.scene import Scene, Settings
from cosim.scene.scene_figures import read_figures
from cosim.scene.toml_file import TomlFile, read_toml, texts, typed

_KEYS = ("model", "title", "outputs", "parameters", "start", "inputs", "run", "figures")
_RUN_KEYS = tuple(Settings.__dataclass_fields__)
_POSITIVE = ("output_interval", "step_size", *GOALS)


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene.

    Args:
        path: A TOML file; a bare name that is no file here is looked up among the shipped scenes.

    Returns:
        The scene; every name, unit and number in it has been checked against its model.

    Raises:
        UsageError: The file is missing or no TOML, or has a value of the wrong type.
        UnknownName: A key, model, variable or solver does not exist, or the model's formulation
            does not compute an output; one that does is named.
        ParameterError: A number is not finite or out of bounds, or its unit does not fit.
        InitialConditionError: A start value is given that follows from others.

    Example:
        >>> read_scene("crank_torque.toml").outputs
        ('T',)
    """
    file = read_toml(find_scene(path))
    file.refuse_unknown((), file.data, _KEYS)
    dae = _model(file)
    outputs = _outputs(file, dae)
    constants, series = _inputs(file, dae)
    values = {**_own_values(file, dae), **constants}
    settings = _settings(file)
    figures = read_figures(file, dae, outputs)
    title = _text(file, "title") if "title" in file.data else ""
    with file.naming():
        return Scene(file.path.stem, dae, title, values, series, outputs, settings, figures)


def scene_values(dae: Dae) -> dict[str, tuple[str, dict[str, float]]]:
    """Return titles and values, SI, of the shipped scenes of a model that have some, by name.

    Example:
        >>> from cosim.scene.scene_file import scene_values
        >>> scene_values(cosim.load("crank_shaft"))["crank_shaft"][1]
        {'alpha': 10.0, 'omega': 50.0}
    """
    found = {}
    for path in shipped_scenes():
        file = read_toml(path)
        if file.data["model"] == dae.full_name and (values := _own_values(file, dae)):
            found[path.stem] = (_text(file, "title"), values)
    return found


def find_scene(path: str | os.PathLike[str]) -> Path:
    """Return the file of a scene: in the file system, else among the shipped ones.

    Raises:
        UnknownName: There is no such file, and no shipped scene of that name.
    """
    if not isinstance(path, str | os.PathLike):
        raise UsageError.of_type("read_scene", path, "the name of a TOML file")
    given = Path(path)
    if given.exists() or len(given.parts) > 1:
        return given
    shipped = {entry.name: entry for entry in shipped_scenes()}
    if given.name not in shipped:
        near = UnknownName.among("the working directory or cosim", "scene", given.name, shipped)
        raise UnknownName(f"{near} (all: cosim list)")
    return shipped[given.name]


def _model(file: TomlFile) -> Dae:
    if "model" not in file.data:
        raise UsageError(f'{file.path}: the model is missing; write model = "NAME"')
    name = _text(file, "model")
    path, colon, function = name.rpartition(".py:")
    if colon:  # a user's own builder, beside the scene
        name = f"{file.path.parent / path}{colon}{function}"
    with file.naming("model"):
        return load(name)


def _outputs(file: TomlFile, dae: Dae) -> tuple[str, ...]:
    if "outputs" not in file.data:
        return ()
    names = texts(file.data["outputs"], file.at("outputs"))
    if not names:
        raise UsageError(f"{file.at('outputs')}: no output is named; leave the key out for all")
    for i, name in enumerate(names):
        if name not in observable(dae):
            where = file.at("outputs", word=name)
            raise UnknownName(f"{where}: {no_such_output(dae, name)}")
        if name in names[:i]:
            raise UsageError(f"{file.at('outputs')}: '{name}' is named twice; name it once")
    return names


def _values(
    file: TomlFile,
    table: str,
    entries: Mapping[str, Any],
    dae: Dae,
    variables: Iterable[Variable],
) -> dict[str, float]:
    """Read a table of numbers in SI units, or of texts with units."""
    known = {variable.name: variable for variable in variables}
    numbers: dict[str, float] = {}
    for name, value in entries.items():
        where = file.at(table, name)
        if name not in known:
            raise _misplaced(where, table, name, dae, known)
        with file.naming(table, name):
            variable = known[name]
            plain = quantity(name, value, variable.unit) if isinstance(value, str) else value
            numbers[name] = checked(dae, variable, plain)
    return numbers


def _misplaced(
    where: str, table: str, name: str, dae: Dae, known: Iterable[str]
) -> UnknownName | UsageError:
    homes = {"parameters": dae.parameters, "start": dae.states, "inputs": dae.inputs}
    for home, variables in homes.items():
        if any(variable.name == name for variable in variables):
            return UsageError(f"{where}: {name} belongs under [{home}], not under [{table}]")
    if name in observable(dae):
        return UsageError(f"{where}: {name} is a result of {dae.full_name} and cannot be set")
    kind = {"parameters": "parameter", "start": "state", "inputs": "input"}[table]
    return UnknownName.among(f"{where}: {dae.full_name}", kind, name, known)


def _own_values(file: TomlFile, dae: Dae) -> dict[str, float]:
    startable = (*dae.states, *(way.variable for way in dae.start_outputs))
    return {
        **_values(file, "parameters", _table(file, "parameters"), dae, dae.parameters),
        **_values(file, "start", _table(file, "start"), dae, startable),
    }


def _inputs(file: TomlFile, dae: Dae) -> tuple[dict[str, float], InputSeries | None]:
    table = _table(file, "inputs")
    constants = {key: value for key, value in table.items() if key != "file"}
    values = _values(file, "inputs", constants, dae, dae.inputs)
    if "file" not in table:
        return values, None
    with file.naming("inputs", "file"):
        name = _checked_text(table["file"], "file")
        series = read_inputs(file.path.parent / name, dae)
    for name in values:
        if name in series.names:
            where = file.at("inputs", name)
            raise UsageError(f"{where}: {name} is also a column of {table['file']}; drop one")
    return values, series


def _settings(file: TomlFile) -> Settings:
    table = _table(file, "run")
    file.refuse_unknown(("run",), table, _RUN_KEYS)
    found: dict[str, Any] = {}
    for key, value in sorted(table.items()):  # the absolute tolerance before the relative one
        with file.naming("run", key):
            if key == "solver":
                found[key] = _checked_text(value, key)
                if found[key] not in SOLVERS:
                    raise UnknownName.among("cosim", "solver", found[key], SOLVERS)
            else:
                found[key] = number("run", key, value, positive=key in _POSITIVE)
            if key == "relative_tolerance":
                Tolerance(found[key], found.get("absolute_tolerance"))
            if key == "absolute_tolerance":
                Tolerance(absolute=found[key])
    with file.naming("run", next((key for key in GOALS if key in found), "stop_time")):
        return Settings(**found)


def _table(file: TomlFile, key: str) -> Mapping[str, Any]:
    table: Mapping[str, Any] = typed(file.data.get(key, {}), dict, f"a table [{key}]", file.at(key))
    return table


def _text(file: TomlFile, key: str) -> str:
    with file.naming(key):
        return _checked_text(file.data[key], key)


def _checked_text(value: Any, key: str) -> str:
    text: str = typed(value, str, f'{key} = "TEXT"', "")
    return text
