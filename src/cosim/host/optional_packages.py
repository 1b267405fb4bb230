"""Optional packages: imported when needed; the error names the command that installs them."""

from importlib import import_module
from typing import Any

from cosim.errors import MissingTool
from cosim.extensions import deferred_signals


def optional_module(name: str, extra: str) -> Any:
    """Return a module of a package that an extra installs.

    Args:
        name: Its import name, `scipy.stats`.
        extra: `data`, `animate`, `check`, `sweep` or `sympy`.

    Raises:
        MissingTool: The package is not installed.
    """
    try:
        with deferred_signals():
            return import_module(name)
    except ImportError as error:
        raise MissingTool(
            f"{name.partition('.')[0]} is not installed; "
            f'bring it with: pip install "cosim-rigid[{extra}]"'
        ) from error
