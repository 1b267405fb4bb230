"""Rigid-body systems as symbolic DAEs: CVODES and IDAS on one backend, FMUs on the other.

    >>> import cosim
    >>> run = cosim.simulate("bicycle", stop_time=1, outputs=["phi", "delta"])
    >>> len(run), run.names
    (101, ('phi', 'delta'))

`cosim.models()` lists all models, `cosim.info("bicycle")` describes one.

Names are imported when first used, so that `import cosim` costs nothing. `__init__.pyi` lists them,
one `from MODULE import NAME as NAME` a line; type checkers read the same file.
"""

from __future__ import annotations

from importlib import import_module

from cosim.presenters import present_by

TYPE_CHECKING = False  # as of `typing`, which takes as long to import as all of this
if TYPE_CHECKING:
    from typing import Any


def _modules() -> dict[str, str]:
    """Return the module of each public name."""
    with open(f"{__file__}i", encoding="utf-8") as stub:  # noqa: PTH123 (pathlib loads slowly)
        lines = [line.split() for line in stub if line.startswith("from ")]
    return {name: module for _, module, _, name, *_ in lines}


_MODULES = _modules()
__all__ = sorted(_MODULES)

present_by(
    animate="cosim.present.playback.animate:animate",
    compare="cosim.present.figures:draw_residuals",
    eigenvalues="cosim.present.study_figures:draw_eigenvalues",
    extremes="cosim.present.study_figures:draw_map",
    methods="cosim.present.study_figures:draw_methods",
    plot="cosim.present.figures:draw_panels",
    sensitivity="cosim.present.study_figures:draw_sensitivity",
    tradeoff="cosim.present.study_figures:draw_tradeoff",
)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # takes longer to import than all the rest

        return version("cosim-rigid")
    if name not in _MODULES:
        raise AttributeError(f"module 'cosim' has no attribute '{name}'{_hint(name)}")
    from cosim.extensions import deferred_signals

    module = _MODULES[name]
    with deferred_signals():
        value = vars(import_module(module)).get(name) or import_module(f"{module}.{name}")
    if callable(value) and not isinstance(value, type):
        value = import_module("cosim.errors").naming_arguments(value)
        value.__module__ = "cosim"  # where pickle finds it
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def _hint(name: str) -> str:
    if name.startswith("_"):  # what Python and notebooks look for
        return ""
    from difflib import get_close_matches

    near = get_close_matches(name, __all__, n=1)
    return f"; did you mean {near[0]}?" if near else "; all: dir(cosim)"
