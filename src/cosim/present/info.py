"""Info: facts about a model, a scene or an FMU, and its variables with their start values."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from casadi_models.dae import Dae, Start, Variable
from cosim.arrays import Vector
from cosim.errors import FmuError
from cosim.fmi.archive import DESCRIPTION, entry_content, opened
from cosim.fmi.check.parsed import Described, parse
from cosim.fmi.run.typed_values import NUMERIC
from cosim.integrate.places import watched_terms
from cosim.integrate.validity import inspect_start
from cosim.model.catalogue import loaded
from cosim.scene.scene import Scene
from cosim.scene.scene_file import read_scene
from cosim.text import MOST_LINES, html_table, text_table

_TITLES = {
    "conditions": "conditions: calculated if --outputs names them",
    "limits": "validity conditions: a run is valid while every margin is positive",
}
_KEYS = (
    *("name", "unit", "shown in", "start", "start kind"),
    *("minimum", "maximum", "nominal", "meaning"),
)
_ROUNDING = 1e-13  # smaller start values, in nominal values, are zero
_VARIABLE_COLUMNS = ("name", "unit", "shown in", "start", "bounds", "meaning")


@dataclass(frozen=True, repr=False)
class Info:
    """Facts on a model, a scene or an FMU.

    Attributes:
        facts: Name, description, source, span, size.
        tables: Rows by kind of variable, with numbers for start, minimum, maximum and nominal
            value; None if there is none.
        limits: (margin at the start, meaning) of the validity conditions.

    Example:
        >>> import cosim
        >>> [row["name"] for row in cosim.info("crank_shaft").tables["states"]]
        ['phi', 'omega']
    """

    facts: Mapping[str, str]
    tables: Mapping[str, Sequence[Mapping[str, Any]]]
    limits: tuple[tuple[float | None, str], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values, for JSON."""
        margins = [margin for margin, _ in self.limits]
        limits = {"limits": [meaning for _, meaning in self.limits], "margins": margins}
        return {**self.facts, **{key: [*rows] for key, rows in self.tables.items()}, **limits}

    def text(self, width: int | None = None) -> str:
        """Return everything as text, in lines of up to `width` letters."""
        wide = max(11, *map(len, self.facts))
        parts = ["\n".join(f"{key:{wide}}  {value}" for key, value in self.facts.items() if value)]
        parts += [f"{title}\n{text_table(rows, width=width)}" for title, rows in self._shown()]
        return "\n\n".join(parts)

    def _shown(self) -> Iterator[tuple[str, list[dict[str, Any]]]]:
        """Yield the title and the rows of each table that has any."""
        for key, rows in self.tables.items():
            if rows:
                yield _TITLES.get(key, key), [_shown_row(row) for row in rows]
        if self.limits:
            margins = [{"at the start": margin, "meaning": text} for margin, text in self.limits]
            yield _TITLES["limits"], margins

    def __str__(self) -> str:
        return self.text()

    def __repr__(self) -> str:
        lines = self.text(100).splitlines()
        left = len(lines) - MOST_LINES + 1
        cut = [*lines[: MOST_LINES - 1], f"... and {left} lines more: print(...)"]
        return "\n".join(lines if left <= 1 else cut)

    def _repr_html_(self) -> str:
        facts = html_table([{"of": key, "is": value} for key, value in self.facts.items() if value])
        return facts + "".join(html_table(rows, title) for title, rows in self._shown())


def info(source: str | os.PathLike[str] | Dae | Scene) -> Info:
    """Return facts about a model, a scene or an FMU.

    Args:
        source: `MODEL`, `MODEL/FORMULATION`, `PATH.py:FUNCTION`, `SCENE.toml`, `FILE.fmu`, or a
            result of `load` or `read_scene`.

    Raises:
        CosimError: There is no such model, scene or file.

    Example:
        >>> facts = info("bicycle").to_dict()
        >>> {row["name"]: row["start"] for row in facts["states"]}["phi_dot"]
        0.5
    """
    if isinstance(source, os.PathLike):
        source = os.fspath(source)
    if isinstance(source, str) and source.lower().endswith(".fmu"):
        return _fmu_info(Path(source))
    if isinstance(source, str) and source.lower().endswith(".toml"):
        source = read_scene(source)
    if isinstance(source, Scene):
        return _of_scene(source)
    return _of_model(source if isinstance(source, Dae) else loaded(source))


def _of_scene(scene: Scene) -> Info:
    of_model = _of_model(scene.request.configured(), scene.request.times.start)
    own = {row["of the scene"]: row["is"] for row in scene.rows()}
    facts = {"scene": scene.name, "title": scene.title, **own} | {
        key: value for key, value in of_model.facts.items() if key != "model"
    }
    return Info(facts, of_model.tables, of_model.limits)


def _of_model(dae: Dae, begin: float = 0.0) -> Info:
    start = inspect_start(dae, begin)
    groups = {
        "states": _variable_rows(dae.states, start.x),
        "algebraic unknowns": _variable_rows(dae.algebraics, start.z),
        "inputs": _variable_rows(dae.inputs),
        "parameters": _variable_rows(dae.parameters),
        "outputs": _variable_rows(dae.output_variables),
    }
    facts = {
        "model": dae.full_name,
        "description": dae.description,
        "source": dae.source,
        "span": f"{begin:.12g} ... {begin + dae.experiment.stop_time:.12g} s",
        "equations": f"{len(dae.states)} differential, {len(dae.algebraics)} algebraic, "
        f"{dae.operations()} scalar operations",
    }
    if dae.start_outputs:
        pairs = ((w.variable.name, dae.states[w.state].name) for w in dae.start_outputs)
        facts["alternative start values"] = ", ".join(f"{y} (for {x})" for y, x in pairs)
    titles = "changes of terms, found in steps", "changes of terms, not found in steps"
    for title, names in zip(titles, watched_terms(dae), strict=True):
        if names:
            facts[title] = "; ".join(f"of {name}" for name in names)
    monitors = zip(dae.monitors, start.monitors, strict=True)
    groups["conditions"] = [
        {"name": v.name, "at the start": value, "meaning": v.meaning} for (v, _), value in monitors
    ]
    meanings = (meaning for _, meaning in dae.limits)
    return Info(facts, groups, tuple(zip(start.margins, meanings, strict=True)))


def _variable_rows(
    variables: Sequence[Variable], starts: Vector | None = None
) -> list[dict[str, Any]]:
    found = [v.start for v in variables] if starts is None else starts.tolist()
    return [_variable_row(v, start) for v, start in zip(variables, found, strict=True)]


def _variable_row(variable: Variable, start: float | None) -> dict[str, Any]:
    low, high = (b if isfinite(b) else None for b in (variable.minimum, variable.maximum))
    kind = "exact" if variable.start_kind is Start.EXACT else "calculated"
    texts = (variable.name, variable.unit, variable.display_unit or variable.unit)
    facts = (*texts, start, kind, low, high, variable.nominal, variable.meaning)
    return dict(zip(_KEYS, facts, strict=True))


def _fmu_info(path: Path) -> Info:
    with opened(path) as archive:
        try:
            described = parse(entry_content(archive, DESCRIPTION))
        except ValueError as error:
            raise FmuError(f"{path}: {DESCRIPTION}: {error}") from error
    root = described.root
    experiment = root.find("DefaultExperiment")
    span = {} if experiment is None else experiment.attrib
    facts = {
        "fmu": path.name,
        "model": root.get("modelName", ""),
        "description": root.get("description", ""),
        "made by": root.get("generationTool", ""),
        "fmi": f"{root.get('fmiVersion')}, {' and '.join(described.interfaces)}",
        "span": f"{span.get('startTime', '0')} ... {span.get('stopTime', '?')} s",
    }
    elements = root.findall("ModelVariables/*")
    tables: dict[str, list[dict[str, Any]]] = {}
    for variable, element in zip(described.variables, elements, strict=True):
        row = _fmu_row(variable, element.get("description", ""))
        if variable.shape:
            row["dimensions"] = [*variable.shape]
        tables.setdefault(variable.causality, []).append(row)
    return Info({key: value for key, value in facts.items() if value}, tables)


def _fmu_row(variable: Described, meaning: str) -> dict[str, Any]:
    texts, unit = variable.texts, variable.texts.get("unit", "1")
    start, *sizes = (_number_or_text(texts.get(key)) for key in ("start", "min", "max", "nominal"))
    if not NUMERIC.match(variable.kind):
        start = texts.get("start")
    sizes = [size if isinstance(size, float) else None for size in sizes]
    facts = (variable.name, unit, texts.get("displayUnit", unit), start, variable.initial or "")
    return dict(zip(_KEYS, (*facts, *sizes, meaning), strict=True))


def _number_or_text(text: str | None) -> Any:
    try:
        return None if text is None else float(text)
    except ValueError:
        return text  # of a string or a boolean


def _shown_bound(bound: float) -> str:
    """Return a bound; those that are far from all usual values with one digit."""
    return f"{bound:.1g}" if bound and not 1e-6 < abs(bound) < 1e6 else f"{bound:g}"


def _shown_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row as a table shows it."""
    if "minimum" not in row:
        return dict(row)
    start, kind = row["start"], row["start kind"]
    if isinstance(start, float) and abs(start) < _ROUNDING * (row["nominal"] or 1.0):
        start = 0.0
    text = "" if start is None else f"{start:.10g}" if isinstance(start, float) else str(start)
    note = f"{text} (calculated)" if text else "calculated"
    low, high = ("" if b is None else _shown_bound(b) for b in (row["minimum"], row["maximum"]))
    bounds = f"{low or '-inf'} ... {high or 'inf'}" if low or high else ""
    indices = ",".join(f"1..{'?' if n is None else n}" for n in row.get("dimensions", ()))
    name = f"{row['name']}[{indices}]" if indices else row["name"]
    start_text = note if kind == "calculated" else text
    shown = {**row, "name": name, "start": start_text, "bounds": bounds}
    return {key: shown[key] for key in _VARIABLE_COLUMNS}
