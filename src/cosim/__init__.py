"""Rigid-body systems as symbolic DAEs: CVODES and IDAS on one road, FMUs on the other.

    >>> import cosim
    >>> run = cosim.simulate("bicycle", stop_time=1, outputs=["phi", "delta"])
    >>> len(run), run.names
    (101, ('phi', 'delta'))

`cosim.models()` is what there is, `cosim.info("bicycle")` what one is.

Names are imported when first used, so that `import cosim` costs nothing.
"""

from __future__ import annotations

from importlib import import_module

from cosim.presenters import present_by

TYPE_CHECKING = False  # as of `typing`, which takes as long to import as all of this
if TYPE_CHECKING:
    from typing import Any

    from casadi_models.dae import Dae, Model
    from cosim import errors, solvers
    from cosim.api import run_scene, simulate
    from cosim.errors import CosimError
    from cosim.fmi.check.check import check_fmu
    from cosim.fmi.export.package import export_fmu
    from cosim.fmi.run.simulate import simulate_fmu
    from cosim.fmi.ssp import write_ssp
    from cosim.integrate.ensemble.ensemble import Ensemble
    from cosim.integrate.ensemble.simulate_many import simulate_many
    from cosim.integrate.integrator import integrator, start_vectors
    from cosim.model.catalogue import load
    from cosim.model.foreign.dae_builder import from_dae_builder
    from cosim.model.foreign.from_casadi import from_casadi
    from cosim.model.inputs import InputSeries, read_inputs
    from cosim.model.reduction.reduce import reduce
    from cosim.model.summary import models
    from cosim.present.figures import draw_figures
    from cosim.present.info import Info, info
    from cosim.present.playback.animate import animate
    from cosim.scene.scene import FigureSpec, Scene, Settings
    from cosim.scene.scene_file import read_scene
    from cosim.series.column import Column
    from cosim.study.extremes.campaign import extremes
    from cosim.study.linearize.linearize import linearize
    from cosim.study.linearize.sweep import linearize_sweep
    from cosim.study.sensitivity.sensitivity import sensitivity
    from cosim.study.sweep.result import SweepResult
    from cosim.study.sweep.sweep import sweep
    from cosim.study.tradeoff.study import tradeoff
    from cosim.trajectory import Trajectory
    from cosim.verify.comparison import Comparison, compare
    from cosim.verify.crosscheck import crosscheck
    from cosim.verify.reference import reference

_HOMES = {
    "Column": "series.column",
    "Comparison": "verify.comparison",
    "CosimError": "errors",
    "Ensemble": "integrate.ensemble.ensemble",
    "FigureSpec": "scene.scene",
    "Info": "present.info",
    "InputSeries": "model.inputs",
    "Scene": "scene.scene",
    "Settings": "scene.scene",
    "SweepResult": "study.sweep.result",
    "Trajectory": "trajectory",
    "animate": "present.playback.animate",
    "check_fmu": "fmi.check.check",
    "compare": "verify.comparison",
    "crosscheck": "verify.crosscheck",
    "draw_figures": "present.figures",
    "export_fmu": "fmi.export.package",
    "extremes": "study.extremes.campaign",
    "from_casadi": "model.foreign.from_casadi",
    "from_dae_builder": "model.foreign.dae_builder",
    "info": "present.info",
    "integrator": "integrate.integrator",
    "linearize": "study.linearize.linearize",
    "linearize_sweep": "study.linearize.sweep",
    "load": "model.catalogue",
    "models": "model.summary",
    "read_inputs": "model.inputs",
    "read_scene": "scene.scene_file",
    "reduce": "model.reduction.reduce",
    "reference": "verify.reference",
    "run_scene": "api",
    "sensitivity": "study.sensitivity.sensitivity",
    "simulate": "api",
    "simulate_fmu": "fmi.run.simulate",
    "simulate_many": "integrate.ensemble.simulate_many",
    "start_vectors": "integrate.integrator",
    "sweep": "study.sweep.sweep",
    "tradeoff": "study.tradeoff.study",
    "write_ssp": "fmi.ssp",
}

__all__ = [
    "Column",
    "Comparison",
    "CosimError",
    "Dae",
    "Ensemble",
    "FigureSpec",
    "Info",
    "InputSeries",
    "Model",
    "Scene",
    "Settings",
    "SweepResult",
    "Trajectory",
    "animate",
    "check_fmu",
    "compare",
    "crosscheck",
    "draw_figures",
    "errors",
    "export_fmu",
    "extremes",
    "from_casadi",
    "from_dae_builder",
    "info",
    "integrator",
    "linearize",
    "linearize_sweep",
    "load",
    "models",
    "read_inputs",
    "read_scene",
    "reduce",
    "reference",
    "run_scene",
    "sensitivity",
    "simulate",
    "simulate_fmu",
    "simulate_many",
    "solvers",
    "start_vectors",
    "sweep",
    "tradeoff",
    "write_ssp",
]

present_by(animate="cosim.present.playback.animate:animate")


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # takes longer to import than all the rest

        return version("cosim-rigid")
    if name in ("Dae", "Model"):
        value = getattr(import_module("casadi_models.dae"), name)
    elif name in ("errors", "solvers"):
        return import_module(f"cosim.{name}")
    elif name in _HOMES:
        value = getattr(import_module(f"cosim.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module 'cosim' has no attribute '{name}'{_hint(name)}")
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
