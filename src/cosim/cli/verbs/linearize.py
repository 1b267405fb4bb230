"""`cosim linearize MODEL|FILE.fmu`: A, B, C, D and eigenvalues, at a state or along a parameter."""

import argparse
from functools import partial
from typing import Any

from cosim.cli.arguments import (
    names_in,
    numbers_in,
    scene_from,
    spaced,
    start_texts,
    start_values_of_fmu,
    value_of,
)
from cosim.cli.tables import draw, note, show_table, write_text
from cosim.errors import UsageError
from cosim.fmi.run.isolated import run_apart
from cosim.fmi.trust import require_trust
from cosim.model.quantities import reject_mixed_units
from cosim.model.solver import Goal
from cosim.scene.scene import Scene
from cosim.study.linearize.linearization import Linearization
from cosim.study.linearize.linearize import EQUILIBRIUM, START, linearize
from cosim.text import csv_text, json_text


def run(args: argparse.Namespace) -> int:
    """Linearize a model or an FMU."""
    if args.figure and not args.along:
        raise UsageError("--figure draws the eigenvalues of --along; add --along NAME=A:B:N")
    model: Any = args.model
    if args.model.lower().endswith(".fmu"):
        require_trust(args.model, trusted=args.trust)
        start = start_values_of_fmu(args)
        outputs = None if args.outputs is None else names_in(args.outputs)
        evaluate: Any = partial(run_apart, function=linearize)
    else:
        scene = scene_from(args)
        request, evaluate = scene.request, partial(linearize, **_settings(args, scene))
        model, start, outputs = request.dae, dict(request.values), request.outputs
    points: list[Any] = [EQUILIBRIUM if args.equilibrium else START]
    if args.at is not None:
        points = [*numbers_in("--at", args.at)]
    if args.along:
        if len(points) > 1:
            raise UsageError("--along needs a single point; give one time with --at")
        return _along(args, evaluate, model, points[0], start, outputs)
    found = [evaluate(model, at=point, start_values=start, outputs=outputs) for point in points]
    if args.output_file:
        if len(found) > 1:
            raise UsageError("-o writes the matrices of a single point; give one time")
        found[0].to_csv(args.output_file)
    if args.json:
        print(json_text([_as_json(linear) for linear in found], indent=1))
        return 0
    for i, linear in enumerate(found):
        _show(linear, matrices=not args.output_file, first=i == 0)
        if linear.undecided:
            modes = (f"{mode.value:.3g} ({' '.join(mode.states)})" for mode in linear.undecided)
            note(args, f"rounding decides whether these grow: {', '.join(modes)}")
    return 0


def _settings(args: argparse.Namespace, scene: Scene) -> dict[str, Any]:
    """Return what a scene says of the run up to the state."""
    request = scene.request
    has_goal = isinstance(request.solver, Goal)
    if has_goal and args.at is not None:
        raise UsageError(
            f"{scene.name}: a run up to a time has no accuracy and no budget here; give a solver "
            "and a tolerance"
        )
    solver = None if has_goal else request.solver
    return {"inputs": request.inputs, "start_time": request.times.start, "solver": solver}


def _along(
    args: argparse.Namespace, evaluate: Any, model: Any, at: Any, start: Any, outputs: Any
) -> int:
    name, equals, span = (part.strip() for part in args.along.partition("="))
    parts = [part.strip() for part in span.split(":")]
    if not equals or len(parts) != 3:
        raise UsageError(f"--along {args.along}: write NAME=A:B:N")
    dae = None if isinstance(model, str) else model
    reject_mixed_units(f"--along {name}", parts[:2])
    first, last = (value_of(dae, name, part) for part in parts[:2])
    values = spaced(f"--along {args.along}", first, last, parts[2])
    if name not in dict(start_texts(args)):
        start.pop(name, None)  # a value of the scene
    found = evaluate(model, along={name: values}, at=at, start_values=start, outputs=outputs)
    if args.output_file:
        write_text(args.output_file, csv_text(found.rows()))
    draw(args, "eigenvalues", found)
    crossings = [crossing.row(name) for crossing in found.crossings]
    if args.json:
        print(json_text({"eigenvalues": found.rows(), "crossings": crossings}, indent=1))
        return 0
    if crossings:
        show_table(crossings)
    else:
        line = "imaginary axis" if found.period is None else "unit circle"
        print(f"no eigenvalue crosses the {line} for {name} = {first:g} ... {last:g}")
    note(args, f"{len(values)} values; {found.points[0]}")
    note(args, "two crossings of one eigenvalue between neighboring values are not found")
    return 0


def _show(linear: Linearization, *, matrices: bool, first: bool) -> None:
    print("" if first else "\n", end="")
    print(f"{linear}\n")
    show_table([mode.row() for mode in linear.modes])
    if matrices:
        print("\nd(row)/d(column)")
        show_table(linear.rows())


def _as_json(linear: Linearization) -> dict[str, Any]:
    facts: dict[str, Any] = {"model": linear.model, "at": linear.point}
    for kind in ("time", "period", "steadiness", "cyclic", "states", "inputs", "outputs"):
        facts[kind] = getattr(linear, kind)
    for kind in ("A", "B", "C", "D", "x", "u", "y"):
        facts[kind] = getattr(linear, kind).tolist()
    return facts | {"modes": [mode.row() for mode in linear.modes]}
