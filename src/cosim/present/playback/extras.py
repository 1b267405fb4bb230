"""Optional packages: imported when they are needed, with the command that brings them."""

from importlib import import_module
from typing import Any

from cosim.errors import MissingTool


def extra(package: str, bundle: str = "animate") -> Any:
    """Return an optional package.

    Raises:
        MissingTool: It is not installed.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise MissingTool(
            f"{package} is not installed; bring it with: pip install 'cosim-rigid[{bundle}]'"
        ) from error
