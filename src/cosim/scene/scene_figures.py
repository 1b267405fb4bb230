"""The tables `[[figures]]` of a scene."""

from collections.abc import Mapping
from typing import Any

from casadi_models.dae import Dae
from casadi_models.units import UNITS
from cosim.errors import UnknownName, UsageError
from cosim.model.catalogue import no_such_output, observable
from cosim.scene.scene import FigureSpec
from cosim.scene.toml_file import TomlFile, text_rows, texts, typed

_FIGURE_KEYS = tuple(FigureSpec.__dataclass_fields__)


def read_figures(file: TomlFile, dae: Dae, outputs: tuple[str, ...]) -> tuple[FigureSpec, ...]:
    """Return what a scene's tables `[[figures]]` say, checked against its model and outputs.

    Raises:
        UsageError, UnknownName, ParameterError: See `read_scene`.
    """
    tables = file.data.get("figures", [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise UsageError(f"{file.at('figures')}: write every figure as a table [[figures]]")
    return tuple(_figure_spec(file, i, table, dae, outputs) for i, table in enumerate(tables))


def _figure_spec(
    file: TomlFile, index: int, table: Mapping[str, Any], dae: Dae, outputs: tuple[str, ...]
) -> FigureSpec:
    here = ("figures", index)
    file.refuse_unknown(here, table, _FIGURE_KEYS)
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
        _refuse_mixed_units(file.at(*here, "panels", word=panel[0]), panel, dae)
    return spec


def _refuse_mixed_units(where: str, panel: tuple[str, ...], dae: Dae) -> None:
    variables = [dae.variable(name) for name in panel]
    for other in variables[1:]:
        if not UNITS[other.unit].measures_like(UNITS[variables[0].unit]):
            raise UsageError(
                f"{where}: {panel[0]} [{variables[0].unit}] and {other.name} [{other.unit}] share "
                "a panel; give each unit a panel of its own"
            )
