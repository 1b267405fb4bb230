"""From the name a user types to a `Dae`: the catalogue, or a builder in the user's own file."""

import importlib.util
import sys
from pathlib import Path

import casadi as ca

import casadi_models
from casadi_models.dae import Dae
from cosim.dae_builder import from_dae_builder
from cosim.errors import UnknownName, UsageError


def load(name: str) -> Dae:
    """Build the DAE of `MODEL`, `MODEL/FORMULATION` or `PATH.py:FUNCTION`.

    Raises:
        UnknownName: The catalogue has no such model, or the file no such function.
        UsageError: The file cannot be read, or its function builds no Dae.
    """
    if ".py:" in name:
        return _from_file(*name.rsplit(":", 1))
    try:
        return casadi_models.load(name)
    except KeyError:
        raise _unknown(name) from None


def formulations(model: str) -> tuple[str, ...]:
    """Return `MODEL/FORMULATION` of every formulation of a model, the default first.

    Raises:
        UnknownName: The catalogue has no such model.
    """
    found = tuple(e for e in casadi_models.CATALOG if model in (e, e.partition("/")[0]))
    if not found:
        raise _unknown(model)
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


def _unknown(name: str) -> UnknownName:
    model, slash, formulation = name.partition("/")
    catalog = casadi_models.CATALOG
    models = dict.fromkeys(entry.partition("/")[0] for entry in catalog)
    if slash and model in models:
        own = [e.partition("/")[2] for e in catalog if e.partition("/")[0] == model]
        return UnknownName.among(model, "formulation", formulation, own)
    near = UnknownName.among("the catalogue", "model", model, models)
    return UnknownName(f"{near} (all: cosim list)")


def _from_file(path: str, function: str) -> Dae:
    if not Path(path).is_file():
        raise UsageError(f"{path} is not a file; name one as PATH.py:FUNCTION")
    spec = importlib.util.spec_from_file_location(f"_cosim_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"{path} is not a Python file; name one as PATH.py:FUNCTION")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look their annotations up
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise UsageError(f"{path} cannot be loaded: {type(error).__name__}: {error}") from error
    builder = getattr(module, function, None)
    if not callable(builder):
        callables = [n for n, v in vars(module).items() if callable(v) and not n.startswith("_")]
        raise UnknownName.among(path, "function", function, callables)
    try:
        built = builder()
    except Exception as error:
        raise UsageError(f"{path}:{function} failed: {type(error).__name__}: {error}") from error
    if isinstance(built, ca.DaeBuilder):
        return from_dae_builder(built)
    if not isinstance(built, Dae):
        raise UsageError(
            f"{path}:{function} returned {type(built).__name__}; return what Model.freeze() "
            "returns, or a casadi.DaeBuilder"
        )
    return built
