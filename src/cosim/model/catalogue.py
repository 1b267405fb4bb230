"""From the name a user types to a `Dae`: the catalogue, or a builder in the user's own file."""

import importlib.util
import sys
from pathlib import Path

import casadi as ca

import casadi_models
from casadi_models.dae import Dae
from cosim.errors import UnknownName, UsageError
from cosim.model.dae_builder import from_dae_builder

_OTHER_FILES = {
    ".py": "name the function that builds it, too, as PATH.py:FUNCTION",
    ".toml": "a scene is taken by simulate, export, crosscheck, tradeoff and plot",
    ".fmu": "an FMU is taken by simulate, crosscheck and plot",
}


def load(name: str) -> Dae:
    """Build the DAE of `MODEL`, `MODEL/FORMULATION` or `PATH.py:FUNCTION`.

    Raises:
        UnknownName: The catalogue has no such model, or the file no such function.
        UsageError: The file cannot be read, or its function fails or builds no Dae.
    """
    if not isinstance(name, str):
        raise UsageError.of_type("load", name, "the name of a model, e.g. 'bicycle'")
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


def _unknown(name: str) -> UnknownName | UsageError:
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
    except (Exception, SystemExit) as error:
        raise UsageError(f"{path} cannot be loaded: {_told(error)}") from error
    builder = getattr(module, function, None)
    if not callable(builder):
        own = (n for n, v in vars(module).items() if getattr(v, "__module__", "") == spec.name)
        raise UnknownName.among(path, "function", function, own)
    try:
        built = builder()
    except (Exception, SystemExit) as error:
        raise UsageError(f"{path}:{function} failed: {_told(error)}") from error
    if isinstance(built, ca.DaeBuilder):
        built = from_dae_builder(built)
    if not isinstance(built, Dae):
        raise UsageError(
            f"{path}:{function} returned {type(built).__name__}; return what Model.freeze() "
            "returns, or a casadi.DaeBuilder"
        )
    if not observable(built):
        raise UsageError(f"{path}:{function} built a model without a state or an output; add one")
    return built


def _told(error: BaseException) -> str:
    """Return an exception of a user's own code in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
