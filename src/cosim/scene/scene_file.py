"""`read_scene` reads a TOML file into a `Scene`; errors name the line."""

import os
from collections.abc import Iterable, Mapping
from typing import Any

from casadi_models.dae import Dae, Variable
from casadi_models.units import UNITS
from cosim.coupling.files import is_system, read_system
from cosim.errors import UnknownName, UsageError
from cosim.integrate.keywords import Keywords, requested
from cosim.integrate.solvers import SOLVERS
from cosim.model.catalogue import loaded, no_such_output, observable
from cosim.model.inputs import InputSeries, read_inputs
from cosim.model.quantities import quantity
from cosim.model.request import RunRequest
from cosim.model.solver import LIMITS, Tolerance
from cosim.model.values import checked, number
from cosim.scene import figures_file, find_scene
from cosim.scene.scene import FigureSpec, Scene
from cosim.toml_file import TomlFile, read_toml, text_rows, texts, typed

_FIGURE_KEYS = tuple(FigureSpec.__dataclass_fields__)


def read_figures(file: TomlFile, dae: Dae, outputs: tuple[str, ...]) -> tuple[FigureSpec, ...]:
    """Return the figures of a scene, checked against its model and outputs."""
    file = figures_file(file)
    tables = file.data.get("figures", [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise UsageError(f"{file.at('figures')}: write every figure as a table [[figures]]")
    return tuple(_figure_spec(file, i, table, dae, outputs) for i, table in enumerate(tables))


def _figure_spec(
    file: TomlFile, index: int, table: Mapping[str, Any], dae: Dae, outputs: tuple[str, ...]
) -> FigureSpec:
    here = ("figures", index)
    file.reject_unknown(here, table, _FIGURE_KEYS)
    for key in ("title", "panels"):
        if key not in table:
            raise UsageError(f"{file.at(*here)}: the figure has no {key}; add one")
    spec = FigureSpec(
        title=typed(table["title"], str, "a text", file.at(*here, "title")),
        panels=text_rows(table["panels"], file.at(*here, "panels")),
        x=typed(table.get("x", "time"), str, "a variable's name", file.at(*here, "x")),
        x_label=typed(table.get("x_label", ""), str, "a text", file.at(*here, "x_label")),
        equal=typed(table.get("equal", False), bool, "true or false", file.at(*here, "equal")),
        labels=texts(table.get("labels", []), file.at(*here, "labels")),
        legends=text_rows(table.get("legends", []), file.at(*here, "legends")),
    )
    if not spec.panels or not all(spec.panels):
        raise UsageError(f"{file.at(*here, 'panels')}: a panel has no variable; name one in each")
    for key, entries in (("labels", spec.labels), ("legends", spec.legends)):
        if entries and len(entries) != len(spec.panels):
            raise UsageError(
                f"{file.at(*here, key)}: {len(entries)} {key} for {len(spec.panels)} panels; "
                "give one per panel"
            )
    for legend, panel in zip(spec.legends, spec.panels, strict=False):
        if len(legend) != len(panel):
            raise UsageError(
                f"{file.at(*here, 'legends')}: {len(legend)} names for the {len(panel)} curves "
                f"{', '.join(panel)}; give one per curve"
            )
    for name in spec.names:
        where = file.at(*here, "x" if name == spec.x else "panels", word=name)
        if name not in observable(dae):
            raise UnknownName(f"{where}: {no_such_output(dae, name)}")
        if outputs and name not in outputs:
            raise UsageError(f"{where}: '{name}' is drawn but not computed; add it to outputs")
    for panel in spec.panels:
        _reject_mixed_units(file.at(*here, "panels", word=panel[0]), panel, dae)
    return spec


def _reject_mixed_units(where: str, panel: tuple[str, ...], dae: Dae) -> None:
    variables = [dae.variable(name) for name in panel]
    for other in variables[1:]:
        if not UNITS[other.unit].measures_like(UNITS[variables[0].unit]):
            raise UsageError(
                f"{where}: {panel[0]} [{variables[0].unit}] and {other.name} [{other.unit}] share "
                "a panel; give each unit a panel of its own"
            )


_KEYS = ("model", "title", "outputs", "parameters", "start", "inputs", "run", "figures")
_GOALS = ("accuracy", "budget")
_POSITIVE = ("output_interval", "step_size", "max_step", *_GOALS)
_TIMES = ("start_time", "stop_time", "output_interval")
_RUN_KEYS = (*_TIMES, "solver", "step_size", *LIMITS, *_GOALS)


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene.

    Args:
        path: A TOML file; a bare name that does not exist here means a shipped scene. A coupled
            system, with [parts], is the scene of all parts as one model.

    Returns:
        The scene; every name, unit and number in it has been checked against its model.

    Raises:
        UsageError: The file is missing or no TOML, or has a value of the wrong type.
        UnknownName: A key, model, variable or solver does not exist, or the model's formulation
            does not compute an output; one that does is named.
        ParameterError: A number is not finite or out of bounds, or its unit does not fit.
        InitialConditionError: A start value is set that is calculated from others.

    Example:
        >>> read_scene("crank_torque.toml").request.outputs
        ('T',)
    """
    place = find_scene(path)
    if is_system(place):
        system = read_system(place)
        return Scene(system.name, RunRequest(system.dae), system.title)
    file = read_toml(place)
    for key in {*file.data} & {*_RUN_KEYS}:
        raise UnknownName(f"{file.at(key)}: {key} belongs under [run]")
    file.reject_unknown((), file.data, _KEYS)
    model = _model_name(file)
    with file.naming("model"):
        dae = loaded(model)
    request = _request(file, dae)
    figures = read_figures(file, dae, request.outputs or ())
    title = _text(file, "title") if "title" in file.data else ""
    return Scene(file.path.stem, request, title, figures, model)


def _model_name(file: TomlFile) -> str:
    if "model" not in file.data:
        raise UsageError(f'{file.path}: the model is missing; write model = "NAME"')
    name = _text(file, "model")
    path, colon, function = name.rpartition(".py:")
    if colon:  # a user's own builder, in the folder of the scene
        name = f"{file.path.parent / path}{colon}{function}"
    return name


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
    file: TomlFile, table: str, entries: Mapping[str, Any], dae: Dae, variables: Iterable[Variable]
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


def _request(file: TomlFile, dae: Dae) -> RunRequest:
    """Return the run of the file: values, outputs, inputs, and the table [run]."""
    outputs = _outputs(file, dae)
    constants, series = _inputs(file, dae)
    startable = (*dae.states, *(rule.variable for rule in dae.start_outputs))
    values = _values(file, "parameters", _table(file, "parameters"), dae, dae.parameters)
    values |= _values(file, "start", _table(file, "start"), dae, startable) | constants
    run = _run_keywords(file)
    with file.naming():
        request = RunRequest(dae, values, outputs=outputs or None, inputs=series)
    with file.naming("run", next((key for key in _GOALS if key in run), "stop_time")):
        return requested(request, **run)


def _run_keywords(file: TomlFile) -> Keywords:
    table = _table(file, "run")
    file.reject_unknown(("run",), table, _RUN_KEYS)
    found: dict[str, Any] = {}
    for key, value in sorted(table.items()):  # the absolute tolerance before the relative one
        with file.naming("run", key):
            if key == "solver":
                found[key] = _checked_text(value, key)
                UnknownName.reject("cosim", "solver", SOLVERS, found[key])
            else:
                found[key] = number("run", key, value, positive=key in _POSITIVE)
            if key == "relative_tolerance":
                Tolerance(found[key], found.get("absolute_tolerance"))
            if key == "absolute_tolerance":
                Tolerance(absolute=found[key])
    keywords: Keywords = found  # type: ignore[assignment]  # its keys are checked above
    return keywords


def _table(file: TomlFile, key: str) -> Mapping[str, Any]:
    table: Mapping[str, Any] = typed(file.data.get(key, {}), dict, f"a table [{key}]", file.at(key))
    return table


def _text(file: TomlFile, key: str) -> str:
    with file.naming(key):
        return _checked_text(file.data[key], key)


def _checked_text(value: Any, key: str) -> str:
    text: str = typed(value, str, f'{key} = "TEXT"', "")
    return text
