"""Coupled systems as files: TOML, and SSP 1.0 and 2.0 packages."""

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from cosim.coupling.couple import couple_within
from cosim.coupling.ssp.reader import identifier, read_ssp
from cosim.coupling.system import System
from cosim.errors import CosimError, UsageError
from cosim.files import is_file
from cosim.model.values import number
from cosim.toml_file import read_toml, texts, typed
from cosim.trajectory import Trajectory

_TABLES = ("parts", "connections", "start_values", "abilities")
_KEYS = ("title", "stop_time", "output_interval", "open_inputs", *_TABLES)
_VARIANT = re.compile(r"(.*\.ssp)#([^#/]+)", re.DOTALL)


def is_system(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a coupled system: an .ssp file, or a TOML file with [parts].

    FILE.ssp#VARIANT means a variant of an .ssp file.
    """
    file = Path(path)
    if file.suffix.lower() == ".ssp" or _VARIANT.fullmatch(str(path)):
        return True
    if file.suffix.lower() == ".toml" and is_file(file):
        with suppress(CosimError):  # raised again where the file is read
            return "parts" in read_toml(file).data
    return False


def read_system(path: str | os.PathLike[str]) -> System:
    """Read a coupled system from a TOML or an SSP file.

    Raises:
        CosimError: See `couple` and `read_ssp`; a message names the line of a TOML file.
    """
    if Path(path).suffix.lower() == ".ssp":
        return read_ssp(path)
    if variant := _VARIANT.fullmatch(str(path)):
        return read_ssp(variant[1], variant=variant[2])
    return _read_toml(Path(path))


def simulate_file(path: str | os.PathLike[str], **options: Any) -> Trajectory:
    """Read a system and simulate it; see `System.simulate`."""
    return read_system(path).simulate(**options)


def coupling_report(run: Trajectory) -> str:
    """Return one line about a co-simulation: its error where that was estimated, and its steps."""
    stats = run.stats
    steps = f"{stats['macro_steps']} macro steps, {stats['rejected_steps']} rejected"
    if "error_estimate" not in stats:
        return f"{run.model}: {steps}; the error of the coupling is not estimated (--accuracy does)"
    return (
        f"{run.model}: error of the coupling at most about {stats['error_estimate']:.1e} "
        f"({stats['error_estimate_of']}); {steps}"
    )


def _read_toml(path: Path) -> System:
    file = read_toml(path)
    file.reject_unknown((), file.data, _KEYS)
    parts, connections, values, abilities = (
        dict(typed(file.data.get(key, {}), dict, f"[{key}]", file.at(key))) for key in _TABLES
    )
    for key, table in (("parts", parts), ("connections", connections)):
        for name, value in table.items():
            typed(value, str, "a text", file.at(key, name))
    times = dict[str, float]()
    for key in ("stop_time", "output_interval"):
        if key in file.data:
            typed(file.data[key], int | float, "a number", file.at(key))  # type: ignore[arg-type] # isinstance takes a union
            with file.naming(key):
                times[key] = number(path.stem, key, file.data[key], positive=True)
    opened = texts(file.data.get("open_inputs", []), file.at("open_inputs"))
    if not parts:
        raise UsageError(f"{file.at('parts')}: [parts] is empty; name a model or an FMU")
    return couple_within(
        parts,
        connections,
        start_values=values,
        open_inputs=opened,
        abilities=abilities,
        folder=path.parent,
        within=file.naming,
        name=identifier(path.stem),
        title=typed(file.data.get("title", ""), str, "a text", file.at("title")),
        **times,
    )
