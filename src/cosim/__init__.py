"""Rigid-body systems as symbolic DAEs: CVODES and IDAS on one road, FMUs on the other.

Names are imported when first used, so that `import cosim` costs nothing.
"""

from importlib import import_module
from importlib.metadata import version as _version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim import solvers
    from cosim.api import run_scene, simulate
    from cosim.errors import CosimError
    from cosim.fmi.export.package import export_fmu
    from cosim.fmi.run.simulate import simulate_fmu
    from cosim.integrate.ensemble import Ensemble
    from cosim.integrate.integrator import integrator, start_vectors
    from cosim.integrate.simulate_many import simulate_many
    from cosim.model.catalogue import load
    from cosim.model.dae_builder import from_dae_builder
    from cosim.model.from_casadi import from_casadi
    from cosim.model.inputs import InputSeries, read_inputs
    from cosim.model.reduction.reduce import reduce
    from cosim.present.animate import animate
    from cosim.present.figures import draw_figures
    from cosim.scene.scene import Scene
    from cosim.scene.scene_file import read_scene
    from cosim.study.sweep.result import SweepResult
    from cosim.study.sweep.sweep import sweep
    from cosim.study.tradeoff.study import tradeoff
    from cosim.trajectory import Trajectory
    from cosim.verify.comparison import Comparison, compare
    from cosim.verify.crosscheck import crosscheck
    from cosim.verify.reference import reference

_HOMES = {
    "Comparison": "verify.comparison",
    "CosimError": "errors",
    "Ensemble": "integrate.ensemble",
    "InputSeries": "model.inputs",
    "Scene": "scene.scene",
    "SweepResult": "study.sweep.result",
    "Trajectory": "trajectory",
    "animate": "present.animate",
    "compare": "verify.comparison",
    "crosscheck": "verify.crosscheck",
    "draw_figures": "present.figures",
    "export_fmu": "fmi.export.package",
    "from_casadi": "model.from_casadi",
    "from_dae_builder": "model.dae_builder",
    "integrator": "integrate.integrator",
    "load": "model.catalogue",
    "read_inputs": "model.inputs",
    "read_scene": "scene.scene_file",
    "reduce": "model.reduction.reduce",
    "reference": "verify.reference",
    "run_scene": "api",
    "simulate": "api",
    "simulate_fmu": "fmi.run.simulate",
    "simulate_many": "integrate.simulate_many",
    "start_vectors": "integrate.integrator",
    "sweep": "study.sweep.sweep",
    "tradeoff": "study.tradeoff.study",
}

__all__ = [
    "Comparison",
    "CosimError",
    "Ensemble",
    "InputSeries",
    "Scene",
    "SweepResult",
    "Trajectory",
    "animate",
    "compare",
    "crosscheck",
    "draw_figures",
    "export_fmu",
    "from_casadi",
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
    "simulate_many",
    "solvers",
    "start_vectors",
    "sweep",
    "tradeoff",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version("cosim-rigid")
    if name == "solvers":
        return import_module("cosim.solvers")
    if name not in _HOMES:
        raise AttributeError(f"module 'cosim' has no attribute '{name}'")
    value = getattr(import_module(f"cosim.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
