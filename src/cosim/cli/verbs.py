"""The verbs of the command line, one function each: a library call, and its text."""

import argparse
import json
import sys
from dataclasses import asdict
from typing import Any

import casadi_models
from casadi_models.dae import Start, Variable
from cosim.api import run_scene
from cosim.cli.arguments import named_scene, names_in, scene_from, start_numbers
from cosim.cli.tables import show_table, write_text
from cosim.errors import Interrupted, SolverError, UnknownName, UsageError
from cosim.integrate.inspection import inspect_start
from cosim.model.catalogue import load
from cosim.scene.goals import GOALS
from cosim.scene.roads import Road, scene_dae
from cosim.scene.scene import Scene
from cosim.scene.scene_file import scene_summaries
from cosim.scene.variants import variant
from cosim.trajectory import Trajectory


def do_list(args: argparse.Namespace) -> int:
    """Show every model and formulation, and the shipped scenes: `cosim list`."""
    models = []
    for name in casadi_models.CATALOG:
        dae = load(name)
        models.append(
            {
                "model": name,
                "states": len(dae.states),
                "algebraics": len(dae.algebraics),
                "parameters": len(dae.parameters),
                "outputs": len(dae.output_variables),
                "description": dae.description,
            }
        )
    scenes = list(scene_summaries())
    if args.json:
        print(json.dumps({"models": models, "scenes": scenes}, indent=1))
        return 0
    show_table(models, as_json=args.json)
    print("\nscenes, for simulate, export, crosscheck and plot")
    show_table(scenes, as_json=args.json)
    return 0


def do_info(args: argparse.Namespace) -> int:
    """Show the variables and the size of the equations: `cosim info MODEL`."""
    dae = load(args.model)
    groups = {
        "states": dae.states,
        "algebraic unknowns": dae.algebraics,
        "inputs": dae.inputs,
        "parameters": dae.parameters,
        "outputs": dae.output_variables,
    }
    facts = {
        "model": dae.full_name,
        "description": dae.description,
        "source": dae.source,
        "span": f"0 ... {dae.experiment.stop_time:g} s",
        "equations": f"{len(dae.states)} differential, {len(dae.algebraics)} algebraic, "
        f"{dae.operations()} scalar operations",
    }
    limits = [meaning for _, meaning in dae.limits]
    start = inspect_start(dae)
    conditions = [
        {"name": v.name, "at the start": value, "meaning": v.meaning}
        for (v, _), value in zip(dae.monitors, start.monitors, strict=True)
    ]
    if args.json:
        tables: dict[str, Any] = {key: [*map(_facts, group)] for key, group in groups.items()}
        tables |= {"conditions": conditions, "limits": limits, "margins": start.margins}
        print(json.dumps(facts | tables, indent=1))
        return 0
    for key, value in facts.items():
        print(f"{key:12} {value}")
    for key, group in groups.items():
        if group:
            print(f"\n{key}")
            show_table([_facts(v) for v in group], as_json=args.json)
    if conditions:
        print("\nconditions: calculated where --outputs names them")
        show_table(conditions, as_json=False)
    if limits:
        print("\nlimits: a run is valid while a margin is positive")
        margins = zip(start.margins, limits, strict=True)
        show_table([{"at the start": m, "meaning": text} for m, text in margins], as_json=False)
    return 0


def do_simulate(args: argparse.Namespace) -> int:
    """Run a model or an FMU: `cosim simulate MODEL|FILE.fmu`."""
    scene = _scene(args)
    run, code = _run_or_partial(args, scene)
    if args.json:
        columns = {name: run[name].tolist() for name in ("time", *run.names)}
        head = {"model": run.model, "status": run.status, "units": run.units}
        text = json.dumps(head | {"stats": dict(run.stats), "values": columns}) + "\n"
        write_text(args.output_file, text)
    else:
        run.to_csv(args.output_file or sys.stdout)
    if args.verbose:
        for line in scene_dae(scene).report if scene else ():
            print(line, file=sys.stderr)
        print(", ".join(f"{key} {value}" for key, value in run.stats.items()), file=sys.stderr)
    return code


def do_export(args: argparse.Namespace) -> int:
    """Write a model or a scene as an FMU: `cosim export MODEL|SCENE.toml -o FILE.fmu`."""
    from cosim.verify.reference_result import export_with_proof

    if args.fmi not in ("2", "3"):
        raise UnknownName.among("cosim export", "FMI version", args.fmi, ("2", "3"))
    scene = scene_from(args)
    dae = scene_dae(scene)
    name = (dae.full_name if ".py:" in args.model else scene.name).replace("/", "_")
    target, accuracy = args.output_file or f"{name}.fmu", scene.settings.accuracy
    options: dict[str, Any] = {"fmi": int(args.fmi), "identifier": name, "solver": args.fmu_solver}
    options["platforms"] = names_in(args.platform)
    if accuracy is None:
        path = export_with_proof(dae, target, **options)
    else:
        from cosim.study.accuracy.fmu import export_accurate

        made = export_accurate(dae, target, accuracy, **options)
        path = made.path
        if not args.quiet:
            print(made, file=sys.stderr)
    if args.verbose:
        print(*dae.report, sep="\n", file=sys.stderr)
    if scene.inputs and not args.quiet:
        told = ", ".join(scene.inputs.names)
        print(f"{told}: inputs of the FMU; the importer supplies their series", file=sys.stderr)
    if not args.quiet:
        print(f"{path} ({path.stat().st_size / 1000:.0f} kB)", file=sys.stderr)
    return 0


def do_crosscheck(args: argparse.Namespace) -> int:
    """Compare all roads and formulations: `cosim crosscheck [MODEL|SCENE.toml|FILE.fmu...]`."""
    from itertools import chain

    from cosim.model.values import number
    from cosim.verify.crosscheck import BOUND, crosscheck
    from cosim.verify.reference_result import check_file

    bound = (
        BOUND if args.bound is None else number("crosscheck", "bound", args.bound, positive=True)
    )
    files = [name for name in args.models if name.endswith(".fmu")]
    if not files:
        _refuse_timeout(args)
    items = [
        named_scene(name) if name.endswith(".toml") else name
        for name in args.models
        if name not in files
    ]
    models = crosscheck(
        items or None,
        stop_time=args.stop_time,
        output_interval=args.output_interval,
        relative_tolerance=args.relative_tolerance,
        bound=bound,
    )
    rows = []
    proofs = chain.from_iterable(check_file(file, args.timeout) for file in files)
    try:
        for check in chain(proofs, models if items or not files else ()):
            row = check.row()
            rows.append(row)
            if not args.quiet:
                told = f"{row['model']}: {row['road']} against {row['against'] or 'others'}"
                found = check.failure or f"{row['difference']:.1e}"
                print(f"{told}: {found} {check.verdict}", file=sys.stderr, flush=True)
                for why in dict.fromkeys(check.left_out.values()):
                    names = " ".join(n for n, reason in check.left_out.items() if reason == why)
                    print(f"  not compared: {names} ({why})", file=sys.stderr, flush=True)
    finally:  # an error or Ctrl-C leaves what has been compared
        if not args.json and not any(row["left_out"] for row in rows):
            rows = [{k: v for k, v in row.items() if k != "left_out"} for row in rows]
        show_table(rows, as_json=args.json)
    verdicts = {row["verdict"] for row in rows}
    return 1 if "FAILED" in verdicts else 4 if "DIFFERS" in verdicts else 0


def do_plot(args: argparse.Namespace) -> int:
    """Draw a run, or two and their difference: `cosim plot MODEL|SCENE.toml|FILE.fmu`."""
    from cosim.present.figures import default_specs, draw_figures
    from cosim.present.picture_files import picture_format, require_screen, save, show

    if args.output_file is None:
        require_screen()
    else:
        picture_format(args.output_file)  # refuses before anything has been computed
    scene = _scene(args)
    second = None if args.compare is None else _second(args, scene)
    run, code = _run_or_partial(args, scene)
    if second:
        other = run_scene(*second, compiled=False if args.interpreted else None)
        specs = (scene and scene.figures) or default_specs(run, other)
        figures = draw_figures(specs, run, other)
    else:
        figures = draw_figures(scene.figures, run) if scene and scene.figures else [run.plot()]
    if args.output_file is None:
        show(figures)
        return code
    for path in save(figures, args.output_file):
        if not args.quiet:
            print(path, file=sys.stderr)
    return code


def _scene(args: argparse.Namespace) -> Scene | None:
    """Return the scene that a command line asks for; None for an FMU."""
    if args.model.endswith(".fmu"):
        return None
    _refuse_timeout(args)
    return scene_from(args)


def _refuse_timeout(args: argparse.Namespace) -> None:
    if args.timeout is not None:
        raise UsageError("--timeout is for FMU files; a model's run ends at its step limit")


def _run_or_partial(args: argparse.Namespace, scene: Scene | None) -> tuple[Trajectory, int]:
    """Return a run and its exit code; of a failed run, what was computed."""
    try:
        run = _run(args, scene)
        for text in run.stats.get("invalid", ()):
            print(f"warning: {run.model}: {text}", file=sys.stderr)
        if "error_estimate" in run.stats and not args.quiet:
            from cosim.study.accuracy.solver_selection import promise_kept

            print(promise_kept(run), file=sys.stderr)
        return run, 0
    except SolverError as error:
        if not isinstance(error.partial, Trajectory) or not len(error.partial):
            raise
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return error.partial, error.exit_code
    except Interrupted as error:
        if not isinstance(error.partial, Trajectory) or not len(error.partial):
            raise
        print(error, file=sys.stderr)
        return error.partial, 130


def _run(args: argparse.Namespace, scene: Scene | None) -> Trajectory:
    if scene is not None:
        if args.interface_type is not None:
            raise UsageError("--interface-type is for FMUs; a model takes --solver")
        return run_scene(
            scene,
            compiled=False if args.interpreted else None,
            on_invalid=args.on_invalid or "warn",
            drift_control=args.drift_control,
        )
    from cosim.fmi.run.isolated import simulate_apart

    own = (
        "solver",
        "absolute_tolerance",
        "step_size",
        "on_invalid",
        "drift_control",
        "interpreted",
    )
    for option in (*own, *GOALS):
        if getattr(args, option) not in (None, False):
            raise UsageError(f"--{option.replace('_', '-')} is for models; an FMU has its own")
    return simulate_apart(
        args.model,
        timeout=args.timeout,
        interface=args.interface_type,
        start_time=args.start_time,
        stop_time=args.stop_time,
        output_interval=args.output_interval,
        relative_tolerance=args.relative_tolerance,
        start=start_numbers(args, None),
        outputs=None if args.outputs is None else names_in(args.outputs),
    )


def _second(args: argparse.Namespace, scene: Scene | None) -> tuple[Scene, Road]:
    """Return scene and road of the run that `--compare` asks for."""
    if scene is None:
        raise UsageError("--compare is for models and scenes; an FMU has one road only")
    return variant(scene, args.compare)


def _facts(variable: Variable) -> dict[str, Any]:
    facts = asdict(variable)
    kind = variable.start_kind
    start = "" if variable.start is None else f"{variable.start:.10g}"
    note = {Start.EXACT: start, Start.CALCULATED: "calculated", Start.GUESS: f"guess {start}"}[kind]
    bounds = (facts["minimum"], facts["maximum"])
    finite = bounds != (float("-inf"), float("inf"))
    return {
        "name": variable.name,
        "unit": variable.unit,
        "shown in": variable.display_unit or variable.unit,
        "start": note,
        "bounds": f"{bounds[0]:g} ... {bounds[1]:g}" if finite else "",
        "meaning": variable.meaning,
    }
