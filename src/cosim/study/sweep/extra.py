"""The packages of the extra `sweep`, imported when they are used."""

from importlib import import_module
from typing import Any

from cosim.errors import MissingTool


def extra(module: str) -> Any:
    """Return a module of an optional package.

    Raises:
        MissingTool: The package is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise MissingTool(
            f"{package} is not installed; bring it with: pip install 'cosim-rigid[sweep]'"
        ) from error
