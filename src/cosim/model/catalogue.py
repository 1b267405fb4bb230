"""From the name a user types to a `Dae`: the catalogue, or a builder in the user's own file."""

from pathlib import Path

import casadi_models
from casadi_models.dae import Dae
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.model.foreign.from_casadi import from_casadi
from cosim.model.foreign.named_symbols import identifier
from cosim.model.user_model import load_user_model

_OTHER_FILES = {
    ".py": "name the function that builds it, too, as PATH.py:FUNCTION",
    ".toml": "a scene is taken by simulate, export, crosscheck, tradeoff and plot",
    ".fmu": "an FMU is taken by simulate, crosscheck and plot",
}


def load(name: str) -> Dae:
    """Build the DAE of `MODEL`, `MODEL/FORMULATION`, `PATH.py:FUNCTION` or `PATH.casadi`.

    Raises:
        UnknownName: The catalogue has no such model, or the file no such function.
        UsageError: The file cannot be read, or its function fails or builds no Dae.

    Example:
        >>> load("crank_shaft").full_name
        'crank_shaft/driven'
    """
    if not isinstance(name, str):
        raise UsageError.of_type("load", name, "the name of a model, e.g. 'bicycle'")
    if ".py:" in name:
        return load_user_model(*name.rsplit(":", 1))
    if name.endswith(".casadi"):
        return _saved_function(name)
    try:
        return casadi_models.load(name)
    except KeyError:
        raise _unknown_model(name) from None


def _saved_function(path: str) -> Dae:
    try:
        return from_casadi(path, name=identifier(Path(path).stem))
    except ParameterError as error:  # the file holds no start values
        raise ParameterError(
            f"{error}, in a function of a Python file that returns '{Path(path).name}' and these"
        ) from error


def formulations(model: str) -> tuple[str, ...]:
    """Return `MODEL/FORMULATION` of every formulation of a model, the default first.

    Raises:
        UnknownName: The catalogue has no such model.
    """
    found = tuple(e for e in casadi_models.CATALOG if model in (e, e.partition("/")[0]))
    if not found:
        raise _unknown_model(model)
    return found


def observable(dae: Dae) -> tuple[str, ...]:
    """Return the names that a run of a model can record: states, unknowns, outputs, monitors."""
    recorded = (*dae.states, *dae.algebraics, *dae.output_variables)
    return tuple(v.name for v in (*recorded, *(v for v, _ in dae.monitors)))


def no_such_output(dae: Dae, name: str) -> UnknownName:
    """Return the error for an output that a model lacks; it names a formulation that has it."""
    for entry in casadi_models.CATALOG:
        other = entry != dae.full_name and entry.partition("/")[0] == dae.name
        if other and name in observable(casadi_models.load(entry)):
            return UnknownName(f"{dae.full_name} does not compute '{name}'; {entry} does")
    return UnknownName.of_model(dae.full_name, "output", name, observable(dae))


def _unknown_model(name: str) -> UnknownName | UsageError:
    if takers := _OTHER_FILES.get(Path(name).suffix):
        return UsageError(f"{name} names no model; {takers}")
    model, slash, formulation = name.partition("/")
    catalog = casadi_models.CATALOG
    models = dict.fromkeys(entry.partition("/")[0] for entry in catalog)
    if slash and model in models:
        own = [e.partition("/")[2] for e in catalog if e.partition("/")[0] == model]
        return UnknownName.among(model, "formulation", formulation, own)
    near = UnknownName.among("the catalogue", "model", model, models)
    return UnknownName(f"{near} (all: cosim list)")
