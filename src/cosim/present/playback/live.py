"""What makes a page compute: a model's FMU as WebAssembly, and what its sliders set."""

from math import inf
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae, Drawing
from cosim.codegen.c_sources import page_source
from cosim.drawing.pose import POINT, motion
from cosim.errors import UsageError
from cosim.fmi.export.build import compiled_library
from cosim.fmi.export.package import FmuOptions, source_files
from cosim.fmi.platforms import WEB_PAGE
from cosim.present.playback.page import column_facts, packed
from cosim.series.samples import Column
from cosim.trajectory import Trajectory

_SLIDERS = {"input": "input", "parameter": "parameter", "local": "start", "output": "start"}


def live_part(dae: Dae, run: Trajectory) -> dict[str, Any]:
    """Return what a page needs to compute runs of a model, at the output times of a run.

    Args:
        dae: The model; its own values are where the sliders begin.
        run: A run of it; its variables are those that the page can show.

    Raises:
        MissingTool: ziglang is not installed, or it fails.
        UsageError: The run holds variables that the model's FMU lacks.
    """
    content = source_files(dae, FmuOptions())
    sources = {Path(p).name: c for p, c in content.items() if p.startswith("sources/")}
    variables = _variables(content["modelDescription.xml"])
    for name in run.names:
        if name not in variables:
            raise UsageError(f"{dae.full_name}: '{name}' is no variable of its FMU; record others")
    drawing = dae.drawing or POINT
    shapes, picture = _picture(drawing)
    symbols = {s.name(): s for s in ca.symvar(picture)}
    time = symbols.pop("time", SX.sym("time"))
    own = [name for name in symbols if name in variables]
    constants = [name for name in symbols if name not in variables]
    numbers = [SX(drawing.numbers[name]) for name in constants]
    [picture] = ca.substitute([picture], [symbols[name] for name in constants], numbers)
    values = ca.vertcat(*(symbols[name] for name in own), SX.sym("curves", len(run.names)))
    drawn = ca.Function("drawn", [values, time], [picture], {"cse": True})
    generator = ca.CodeGenerator("drawing", {"with_header": False})
    generator.add(drawn)
    sources["drawing.c"] = generator.dump().encode()
    sources["page.c"] = page_source()
    references = [variables[name]["reference"] for name in (*own, *run.names)]
    return {
        "program": packed(compiled_library(sources, "page", WEB_PAGE)),
        "settings": [v for v in variables.values() if "value" in v],
        "references": references,
        "first": len(own),
        "times": run.time.tolist(),
        "width": len(references) + picture.numel(),
        "shapes": shapes,
    }


def _picture(drawing: Drawing) -> tuple[int, SX]:
    """Return how many numbers describe the shapes, and all numbers of a row for scene.js."""
    shapes = [ca.vertcat(ca.vec(s.size), s.at, s.along) for s in drawing.shapes]
    arrows = [ca.vertcat(a.at, a.vector) for a in drawing.arrows]
    points = [trace.at for trace in drawing.traces]
    picture = ca.densify(ca.vertcat(motion(drawing), *arrows, *points, *shapes))
    return sum(shape.numel() for shape in shapes), picture


def _variables(description: bytes) -> dict[str, dict[str, Any]]:
    """Return what a page knows of an FMU's variables; those with a `value` can be set."""
    found = {}
    for variable in ElementTree.fromstring(description).iter("ScalarVariable"):
        if (real := variable.find("Real")) is None:
            continue
        name, causality = variable.attrib["name"], variable.get("causality", "local")
        unit, meaning = real.get("unit", "1"), variable.get("description", "")
        facts = column_facts(Column(name, unit, real.get("displayUnit"), meaning=meaning))
        found[name] = facts | {"reference": int(variable.attrib["valueReference"])}
        if causality in ("input", "parameter") or variable.get("initial") == "exact":
            value = float(real.get("start", 0))
            low, high = _range(value, real)
            found[name] |= {"kind": _SLIDERS[causality], "value": value, "low": low, "high": high}
    return found


def _range(value: float, real: ElementTree.Element) -> tuple[float, float]:
    """Return the ends of a slider: up to twice the value, or the nominal value to both sides."""
    least, most = float(real.get("min", -inf)), float(real.get("max", inf))
    reach = abs(value) or float(real.get("nominal", 1))
    low = 0.1 * value if least >= 0 < value else value - reach
    return max(least, low), min(most, value + reach)
