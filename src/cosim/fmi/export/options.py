"""Options of an export: `FmuOptions`, checked when they are created."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import TypedDict

from casadi_models.dae import Dae
from casadi_models.units import represented
from cosim.codegen.fmu.solver import FIXED_STEPS
from cosim.errors import ExportError, ParameterError, UnknownName, UsageError
from cosim.fmi.export.dialect import DIALECTS
from cosim.fmi.platforms import NATIVE
from cosim.model.values import number

_C_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,99}")
# C11 keywords, then names that Windows keeps for devices
_RESERVED = (
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while main "
    "con prn aux nul com1 com2 com3 com4 com5 com6 com7 com8 com9 "
    "lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9"
)


def model_identifier(name: str) -> str:
    """Return the identifier of `MODEL/FORMULATION`: the slash becomes an underscore.

    Raises:
        ExportError: The result is no C name of at most 100 characters, or is a reserved word.
    """
    identifier = name.replace("/", "_", 1)
    if not _C_NAME.fullmatch(identifier):
        raise ExportError(
            f"'{name}' cannot name an FMU: use at most 100 ASCII letters, digits and _, "
            "beginning with a letter or _"
        )
    if identifier.lower() in _RESERVED.split():
        raise ExportError(f"'{name}' cannot name an FMU: it is a reserved word; choose another")
    return identifier


TOLERANCE = 1e-9  # recommended to importers, whose solvers take it as the error per step
ABOUT = {"author": "author", "license": "license", "date": "generationDateAndTime"}


class NameStyle(StrEnum):
    """How an FMU names the components of vectors: `fx_A` or `A.f[1]`."""

    FLAT = "flat"
    STRUCTURED = "structured"


class FmuKeywords(TypedDict, total=False):
    """The keywords of `export_fmu`, which documents them."""

    fmi: int
    identifier: str | None
    outputs: Sequence[str] | None
    platforms: Sequence[str]
    tolerance: float
    solver: str | None
    step_size: float | None
    max_step: float | None
    tunable: Sequence[str] | None
    adjoint: bool
    derivatives: bool
    about: Mapping[str, str] | None
    valid: bool
    names: str


def _date(text: str) -> str:
    """Return a date with its time, as XML writes it."""
    try:
        return datetime.fromisoformat(text).isoformat().replace("+00:00", "Z")
    except ValueError:
        raise ParameterError(
            f"export: date = {represented(text)} is no date; write it like 2026-12-31T23:59:00Z"
        ) from None


@dataclass(frozen=True)
class FmuOptions:
    """Export options that hold for any model, checked when they are created; see `export_fmu`."""

    fmi: int = 2
    identifier: str | None = None
    outputs: Sequence[str] | None = None
    platforms: Sequence[str] = (NATIVE,)
    tolerance: float = TOLERANCE
    solver: str | None = None
    step_size: float | None = None
    max_step: float | None = None
    tunable: Sequence[str] | None = None
    adjoint: bool = False
    derivatives: bool = True
    about: Mapping[str, str] | None = None
    valid: bool = False
    names: str = NameStyle.FLAT

    def __post_init__(self) -> None:
        """Check every option that does not depend on the model."""
        if type(self.fmi) is not int or self.fmi not in DIALECTS:
            raise UnknownName.among("cosim", "FMI version", str(self.fmi), map(str, DIALECTS))
        if isinstance(self.platforms, str):
            raise UsageError.of_type("export_fmu", self.platforms, "a list of platforms")
        tolerance = number("export", "tolerance", self.tolerance)
        if not 1e-13 <= tolerance <= 0.1:
            raise ParameterError(f"export: tolerance = {tolerance:g} is not within 1e-13 ... 0.1")
        object.__setattr__(self, "tolerance", tolerance)
        for name in ("step_size", "max_step"):
            value, fixed = getattr(self, name), self.solver in FIXED_STEPS
            if value is None:
                continue
            object.__setattr__(self, name, number("export", name, value, positive=True))
            if fixed != (name == "step_size"):
                other = "the adaptive ones" if fixed else " and ".join(FIXED_STEPS)
                raise UsageError(f"export: {name} is for other solvers: {other}; name one")
        UnknownName.reject("export", "fact about an FMU", ABOUT, *(self.about or {}))
        if self.about and (date := self.about.get("date")) is not None:
            object.__setattr__(self, "about", {**self.about, "date": _date(date)})
        if self.adjoint and not self.derivatives:
            raise UsageError("export: adjoint needs derivatives; leave one of the options out")
        if self.adjoint and self.fmi == 2:
            raise UsageError("export: FMI 2.0 has no adjoint derivatives; use --fmi 3")
        UnknownName.reject("export", "kind of names", tuple(NameStyle), self.names)

    def identifier_of(self, dae: Dae) -> str:
        """Return the C identifier of a model's FMU."""
        return model_identifier(dae.full_name if self.identifier is None else self.identifier)
