"""`cosim fit MODEL|SCENE.toml|FILE.fmu DATA.csv ...`: values that fit measurements."""

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from casadi_models.dae import Dae
from cosim.cli.arguments import (
    assigned,
    named_scene,
    names_in,
    start_numbers,
    start_texts,
    value_in,
    value_of,
    with_values,
)
from cosim.cli.runs import fmu_columns, model_columns, read_measured
from cosim.cli.tables import note, show_table
from cosim.errors import UsageError
from cosim.fmi.run.isolated import run_apart
from cosim.fmi.trust import require_trust
from cosim.model.quantities import reject_mixed_units
from cosim.model.solver import AdaptiveSolver
from cosim.scene.scene import Scene
from cosim.study.fit.fit import fit
from cosim.study.fit.result import Fit
from cosim.text import json_text

_FORMS = "A:B, A:C:B or VALUE[UNIT]"


def run(args: argparse.Namespace) -> int:
    """Fit values, show them with their confidence, and write a scene or an FMU."""
    model: Any = args.model
    scene: Any = None
    dae, inputs, like, settings = None, None, None, dict[str, Any]()
    ranges = [item for item in args.values if ":" in item.partition("=")[2]]
    args.values = [item for item in args.values if item not in ranges]
    if args.model.lower().endswith(".fmu"):
        if args.output_file:
            raise UsageError("-o writes a scene or an FMU of a model; an FMU was given")
        if args.solver:
            raise UsageError("--solver is for models; an FMU has its own")
        require_trust(args.model, trusted=args.trust)
        start, like = start_numbers(args, dae), fmu_columns(args.model)
    else:
        scene = named_scene(args.model)
        request = with_values(args, scene.request)
        if begin := request.times.start:
            raise UsageError(
                f"{scene.name} begins at {begin:g} s, but the runs of a fit begin at 0 s; set its "
                "start_time to 0, and shift the records (--time-offset)"
            )
        model = dae = request.dae
        start, like = dict(request.values), model_columns(dae)
        inputs, own = request.inputs, request.solver
        settings["solver"] = args.solver or (own.name if isinstance(own, AdaptiveSolver) else None)
        settings["relative_tolerance"] = request.relative_tolerance
    unknowns = _unknowns(args, dae, ranges, start)
    start = {name: value for name, value in start.items() if name not in unknowns}
    if inputs is not None:
        settings["inputs"] = inputs.only({*inputs.names} - unknowns.keys())
    records = [read_measured(args, path, like) for path in args.data]
    units = {column.name: column.unit for record in records for column in record.columns}
    noise = {
        name: value_in(name, text, units.get(name), difference=True)
        for name, text in assigned("--noise", args.noise, "SIZE[UNIT]")
    }
    if args.relative_tolerance is not None:
        settings["relative_tolerance"] = args.relative_tolerance
    fitted = partial(run_apart, timeout=args.timeout, function=fit) if dae is None else fit
    found = fitted(
        model,
        measured=records,
        parameters=unknowns,
        each=names_in(args.each) if args.each else (),
        start_values=start,
        noise=noise or None,
        loss=args.loss,
        starts=args.starts,
        seed=args.seed,
        **{name: value for name, value in settings.items() if value is not None},
    )
    if args.figure:
        found.plot(args.figure)
    if args.output_file:
        note(args, args.output_file, *_written(found, args.output_file, scene))
    if args.json:
        print(json_text(_as_json(found), indent=1))
        return 0
    print(f"{found}\n")
    show_table(found.rows())
    note(args, *found.unidentified, *found.notes)
    note(args, f"derivatives: {found.subject.derivatives}")
    return 0


def _unknowns(
    args: argparse.Namespace, dae: Dae | None, ranges: Sequence[str], start: Mapping[str, float]
) -> dict[str, Any]:
    """Return what is fitted: `--free` from the values of a start on, `-p NAME=A:B` in ranges."""
    free = names_in(args.free) if args.free else ()
    found: dict[str, Any] = {name: start.get(name) for name in free}
    for name, text in assigned("-p", ranges, _FORMS):
        if name in dict(start_texts(args)):
            raise UsageError(f"{name} is given twice; give it once")
        parts = text.split(":")
        reject_mixed_units(f"-p {name}", parts)
        found[name] = tuple(value_of(dae, name, part) for part in parts)
    return found


def _written(found: Fit, target: str, scene: Scene) -> list[str]:
    """Write the fitted model as a scene or an FMU; return a note on what a scene leaves out."""
    if target.lower().endswith(".toml"):
        found.write_scene(target, scene.model)
        left = {"inputs", "run", "figures"} & {row["of the scene"] for row in scene.rows()}
        names = ", ".join(sorted(left))
        return [f"it holds values only; add the {names} of {scene.name}"] if left else []
    from cosim.fmi.export.package import export_fmu

    export_fmu(found.dae, target)
    return []


def _as_json(found: Fit) -> dict[str, Any]:
    names = ("values", "errors", "intervals", "confidence", "rank", "unidentified", "notes")
    facts = {name: getattr(found, name) for name in (*names, "noise", "samples")}
    return {"model": found.subject.name, "correlation": found.correlation.tolist(), **facts}
