"""From a name to a `Dae`: the catalogue, and models in users' own files.

CasADi is imported only when a model is built: a list of the models needs none.
"""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from inspect import Signature, signature
from pathlib import Path
from traceback import extract_tb
from typing import TYPE_CHECKING, Any

import casadi_models
from casadi_models import CATALOG
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.files import is_file
from cosim.memo import cached_per_thread
from cosim.text import Table, described

if TYPE_CHECKING:
    from casadi_models.dae import Dae


def load_user_model(path: str, function: str) -> Dae:
    """Build the model that a function of a Python file describes.

    It may return a `Dae`, a `casadi.DaeBuilder`, whatever `from_casadi` takes, or such a system
    with its start values as a pair; a dict may hold the options of `from_casadi`, too.

    Raises:
        UnknownName: The file has no such function.
        UsageError: The file cannot be read, or its function fails or builds no model.
    """
    import casadi as ca

    from casadi_models.dae import Dae
    from cosim.model.foreign.dae_builder import from_dae_builder
    from cosim.model.foreign.from_casadi import from_user, is_system
    from cosim.model.foreign.named_symbols import identifier

    builder = _builder(path, function)
    with _explained(path, f"{path}:{function} failed"):
        built = builder()
    if isinstance(built, ca.DaeBuilder):
        built = from_dae_builder(built)
    elif is_system(built):
        built = from_user(built, identifier(Path(path).stem))
    if not isinstance(built, Dae):
        raise UsageError(
            f"{path}:{function} returned {type(built).__name__}; return what Model.freeze() "
            "returns, a casadi.DaeBuilder, or what cosim.from_casadi takes"
        )
    if not (built.states or built.algebraics or built.output_variables or built.monitors):
        raise UsageError(f"{path}:{function} built a model without a state or an output; add one")
    return built


def _builder(path: str, function: str) -> Callable[[], Any]:
    if not is_file(path):
        raise UnknownName(f"{path} is not a file; name one as PATH.py:FUNCTION")
    spec = importlib.util.spec_from_file_location(f"_cosim_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"{path} is not a Python file; name one as PATH.py:FUNCTION")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look their annotations up
    with _explained(path, f"{path} cannot be loaded"):
        spec.loader.exec_module(module)
    builder = getattr(module, function, None)
    if not callable(builder):
        own = (n for n, v in vars(module).items() if getattr(v, "__module__", "") == spec.name)
        raise UnknownName.among(path, "function", function, own)
    found: Callable[[], Any] = builder
    return found


@contextmanager
def _explained(path: str, what: str) -> Iterator[None]:
    """Explain an exception of a user's file in one line, with the line where it was raised."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        reason = described(error)
        if "truth value of a CasADi" in reason:
            reason = "Python's `if`, `and` and `not` cannot choose between symbols; "
            reason += "use casadi.if_else(x > 0, a, b), casadi.logic_and and casadi.logic_not"
        elif call := re.match(r"TypeError: \w+\.(\w+)\(\) (?:takes|missing|got)", reason):
            reason = _wrong_call(call[1], reason)
        own, trace = Path(path).resolve(), extract_tb(error.__traceback__)
        lines = [at.lineno for at in trace if Path(at.filename).resolve() == own]
        where = f" (line {lines[-1]})" if lines else ""
        raise UsageError(f"{what}{where}: {reason}") from error


def _wrong_call(method: str, reason: str) -> str:
    """Add how a method of `Model` is called; its base classes are no names that users know."""
    from casadi_models.dae import Model

    if not hasattr(Model, method):
        return reason
    given = list(signature(getattr(Model, method)).parameters.values())[1:]
    bare = [one.replace(annotation=one.empty) for one in given]
    reason = re.sub(r"\w+\.", "Model.", reason, count=1)
    return f"{reason}; write {method}{Signature(bare)}"


_OTHER_FILES = {
    ".py": "name the function that builds it, too, as PATH.py:FUNCTION",
    ".ssp": "a system is taken by simulate, tradeoff and info; in Python, by cosim.read_ssp",
    ".toml": "a scene is taken by most verbs; in Python, by cosim.read_scene",
    ".csv": "a result is taken by plot and animate; in Python, by cosim.Trajectory.read_csv",
    ".mat": "a MATLAB file is for MATLAB and Octave; write NAME.csv for plot and animate",
    ".json": "JSON is for other programs; write NAME.csv for plot and animate",
    ".fmu": "an FMU is taken by simulate, crosscheck and plot; in Python, by cosim.simulate_fmu",
}


def load(name: str) -> Dae:
    """Build the DAE of `MODEL`, `MODEL/FORMULATION`, `PATH.py:FUNCTION` or `PATH.casadi`.

    Raises:
        UnknownName: The catalogue has no such model, or there is no such file or function.
        UsageError: The file cannot be read, or its function fails or builds no Dae.

    Example:
        >>> load("crank_shaft").full_name
        'crank_shaft/driven'
    """
    UsageError.reject("load", name, str, "the name of a model, e.g. 'bicycle'")
    if ".py:" in name:
        return load_user_model(*name.rsplit(":", 1))
    if name.endswith(".casadi"):
        return _saved_function(name)
    try:
        return casadi_models.load(name)
    except KeyError:
        raise _unknown_model(name) from None


_A_MODEL = "a model's name, or a Dae, as cosim.load or cosim.from_casadi returns"
_of_the_catalogue = cached_per_thread(16)(load)


def loaded(name: str) -> Dae:
    """Return what `load` builds; a model of the catalogue is built once in each thread."""
    return _of_the_catalogue(name) if type(name) is str and "." not in name else load(name)


def model_of(caller: str, model: Dae | str) -> Dae:
    """Return a model, also by its name; one of the catalogue is built once.

    Raises:
        UsageError: It is neither; or see `load`.
        UnknownName: See `load`.
    """
    from casadi_models.dae import Dae

    if isinstance(model, str):
        return loaded(model)
    UsageError.reject(caller, model, Dae, _A_MODEL)
    return model


def _saved_function(path: str) -> Dae:
    from cosim.model.foreign.from_casadi import from_casadi
    from cosim.model.foreign.named_symbols import identifier

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
        if other and name in observable(loaded(entry)):
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
    near = UnknownName.among("cosim", "model", model, models)
    return UnknownName(f"{near} (all: cosim info)")


FILE = Path(__file__).with_name("catalogue.json")


def models() -> Table:
    """Return every model and formulation, the first formulation of a model being its default.

    The rows are recorded; a formulation that is not is built.

    Example:
        >>> models()[0]["model"], len(models())
        ('crank_shaft/driven', 13)
    """
    recorded = json.loads(FILE.read_text(encoding="utf-8"))
    rows = ({"model": name, **(recorded.get(name) or facts_of(name))} for name in CATALOG)
    return Table(tuple(rows))


def facts_of(name: str) -> dict[str, Any]:
    """Return the row of a formulation from its model."""
    dae = loaded(name)
    return {
        "states": len(dae.states),
        "algebraics": len(dae.algebraics),
        "parameters": len(dae.parameters),
        "outputs": len(dae.output_variables),
        "description": dae.description,
    }


def record(tell: Callable[[str], None] = print) -> None:
    """Write the rows of all formulations: `python -m cosim.model.catalogue`."""
    rows = {name: facts_of(name) for name in CATALOG}
    FILE.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    tell(f"{FILE}: {len(rows)} formulations")


if __name__ == "__main__":
    record()
