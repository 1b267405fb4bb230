"""Rigid-body systems as symbolic DAEs: CVODES and IDAS on one road, FMUs on the other.

Names are imported when first used, so that `import cosim` costs nothing.
"""

from importlib import import_module
from importlib.metadata import version as _version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.comparison import Comparison, compare
    from cosim.crosschecks import crosscheck
    from cosim.dae_builder import from_dae_builder
    from cosim.errors import CosimError
    from cosim.export import export_fmu
    from cosim.figures import draw_figures
    from cosim.fmpy_run import simulate_fmu
    from cosim.inputs import InputSeries, read_inputs
    from cosim.integrate import integrator, simulate, start_vectors
    from cosim.loading import load
    from cosim.reduction import reduce
    from cosim.references import reference
    from cosim.roads import run_scene
    from cosim.scene import Scene
    from cosim.scene_file import read_scene
    from cosim.tradeoffs import tradeoff
    from cosim.trajectory import Trajectory

_HOMES = {
    "Comparison": "comparison",
    "CosimError": "errors",
    "InputSeries": "inputs",
    "Scene": "scene",
    "Trajectory": "trajectory",
    "compare": "comparison",
    "crosscheck": "crosschecks",
    "draw_figures": "figures",
    "export_fmu": "export",
    "from_dae_builder": "dae_builder",
    "integrator": "integrate",
    "load": "loading",
    "read_inputs": "inputs",
    "read_scene": "scene_file",
    "reduce": "reduction",
    "reference": "references",
    "run_scene": "roads",
    "simulate": "integrate",
    "simulate_fmu": "fmpy_run",
    "start_vectors": "integrate",
    "tradeoff": "tradeoffs",
}

__all__ = [
    "Comparison",
    "CosimError",
    "InputSeries",
    "Scene",
    "Trajectory",
    "compare",
    "crosscheck",
    "draw_figures",
    "export_fmu",
    "from_dae_builder",
    "integrator",
    "load",
    "read_inputs",
    "read_scene",
    "reduce",
    "reference",
    "run_scene",
    "simulate",
    "simulate_fmu",
    "start_vectors",
    "tradeoff",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version("cosim-rigid")
    if name not in _HOMES:
        raise AttributeError(f"module 'cosim' has no attribute '{name}'")
    value = getattr(import_module(f"cosim.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
