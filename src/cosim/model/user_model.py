"""A builder in a user's own file, `PATH.py:FUNCTION`, and what it may return."""

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca

from casadi_models.dae import Dae
from cosim.errors import UnknownName, UsageError
from cosim.model.foreign.dae_builder import from_dae_builder
from cosim.model.foreign.from_casadi import from_user, is_system
from cosim.model.foreign.named_symbols import identifier
from cosim.text.escaping import sentence


def load_user_model(path: str, function: str) -> Dae:
    """Build what a function of a Python file describes.

    It may return a `Dae`, a `casadi.DaeBuilder`, whatever `from_casadi` takes, or such a system
    with its start values as a pair; a dict may hold the options of `from_casadi`, too.

    Raises:
        UnknownName: The file has no such function.
        UsageError: The file cannot be read, or its function fails or builds no model.
    """
    builder = _builder(path, function)
    try:
        built = builder()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise UsageError(f"{path}:{function} failed: {_told(error)}") from error
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
    if not Path(path).is_file():
        raise UsageError(f"{path} is not a file; name one as PATH.py:FUNCTION")
    spec = importlib.util.spec_from_file_location(f"_cosim_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"{path} is not a Python file; name one as PATH.py:FUNCTION")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look their annotations up
    try:
        spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise UsageError(f"{path} cannot be loaded: {_told(error)}") from error
    builder = getattr(module, function, None)
    if not callable(builder):
        own = (n for n, v in vars(module).items() if getattr(v, "__module__", "") == spec.name)
        raise UnknownName.among(path, "function", function, own)
    found: Callable[[], Any] = builder
    return found


def _told(error: BaseException) -> str:
    """Return an exception of a user's own code in one line."""
    return sentence(f"{type(error).__name__}: {error}").removesuffix(":")
