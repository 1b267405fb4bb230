"""The verbs of the command line, one function each: a library call, and its text."""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import casadi_models
from casadi_models.dae import Dae, Start, Variable
from cosim.errors import SolverError, UnknownName, UsageError
from cosim.loading import load
from cosim.trajectory import Trajectory
from cosim.values import quantity


def do_list(args: argparse.Namespace) -> int:
    """Show every model and formulation: `cosim list`."""
    rows = []
    for name in casadi_models.CATALOG:
        dae = load(name)
        rows.append(
            {
                "model": name,
                "states": len(dae.states),
                "algebraics": len(dae.algebraics),
                "parameters": len(dae.parameters),
                "outputs": len(dae.output_variables),
                "description": dae.description,
            }
        )
    _show(args, rows)
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
    if args.json:
        tables = {key: [_facts(v) for v in group] for key, group in groups.items()}
        print(json.dumps(facts | tables, indent=1))
        return 0
    for key, value in facts.items():
        print(f"{key:12} {value}")
    for key, group in groups.items():
        if group:
            print(f"\n{key}")
            _show(args, [_facts(v) for v in group])
    return 0


def do_simulate(args: argparse.Namespace) -> int:
    """Run a model or an FMU: `cosim simulate MODEL|FILE.fmu`."""
    code = 0
    try:
        run = _run(args)
    except SolverError as error:
        if error.partial is None:
            raise
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        run, code = error.partial, error.exit_code
    if args.json:
        columns = {name: run[name].tolist() for name in ("time", *run.names)}
        head = {"model": run.model, "status": run.status, "units": run.units}
        _write(args, json.dumps(head | {"stats": dict(run.stats), "values": columns}) + "\n")
    else:
        run.to_csv(args.output_file or sys.stdout)
    if args.verbose:
        print(", ".join(f"{key} {value}" for key, value in run.stats.items()), file=sys.stderr)
    return code


def do_export(args: argparse.Namespace) -> int:
    """Write a model as an FMU: `cosim export MODEL -o FILE.fmu`."""
    from cosim.export import export_fmu

    if args.fmi not in ("2", "3"):
        raise UnknownName.among("cosim export", "FMI version", args.fmi, ("2", "3"))
    dae = load(args.model)
    identifier = None if ".py:" in args.model else args.model
    name = (identifier or dae.full_name).replace("/", "_")
    outputs = args.outputs.split(",") if args.outputs else None
    path = export_fmu(
        dae,
        args.output_file or f"{name}.fmu",
        fmi=int(args.fmi),
        identifier=identifier,
        outputs=outputs,
    )
    if not args.quiet:
        print(f"{path} ({path.stat().st_size / 1000:.0f} kB)", file=sys.stderr)
    return 0


def do_crosscheck(args: argparse.Namespace) -> int:
    """Compare all roads and formulations: `cosim crosscheck [MODEL...]`."""
    from cosim.crosschecks import BOUND, TOLERANCE, crosscheck
    from cosim.values import number

    bound = (
        BOUND if args.bound is None else number("crosscheck", "bound", args.bound, positive=True)
    )
    rows = []
    for check in crosscheck(
        args.models or None,
        stop_time=args.stop_time,
        output_interval=args.output_interval,
        relative_tolerance=TOLERANCE
        if args.relative_tolerance is None
        else args.relative_tolerance,
        bound=bound,
    ):
        row = check.row()
        rows.append(row)
        if not args.quiet:
            told = f"{row['model']}: {row['road']} against {row['against']}"
            print(f"{told}: {row['difference']:.1e} {row['verdict']}", file=sys.stderr, flush=True)
    _show(args, rows)
    return 0 if all(row["verdict"] == "ok" for row in rows) else 4


def do_plot(args: argparse.Namespace) -> int:
    """Draw a run: `cosim plot MODEL`."""
    from cosim.plots import save, show

    figure = _run(args).plot()
    if args.output_file:
        save(figure, args.output_file)
    else:
        show(figure)
    return 0


def _run(args: argparse.Namespace) -> Trajectory:
    tolerance = (
        {} if args.relative_tolerance is None else {"relative_tolerance": args.relative_tolerance}
    )
    outputs = args.outputs.split(",") if args.outputs else None
    span = {"stop_time": args.stop_time, "output_interval": args.output_interval}
    if args.model.endswith(".fmu"):
        from cosim.fmpy_run import simulate_fmu

        for option in ("solver", "absolute_tolerance", "step_size"):
            if getattr(args, option) is not None:
                raise UsageError(f"--{option.replace('_', '-')} is for models; an FMU has its own")
        return simulate_fmu(
            args.model,
            interface=args.interface_type,
            start_time=args.start_time,
            start=_numbers(args),
            outputs=outputs,
            **span,
            **tolerance,
        )
    from cosim.integrate import simulate

    dae = load(args.model)
    return simulate(
        dae,
        start_time=args.start_time or 0.0,
        solver=args.solver,
        absolute_tolerance=args.absolute_tolerance,
        step_size=args.step_size,
        start=_numbers(args, dae),
        outputs=outputs,
        compiled=False if args.interpreted else None,
        **span,
        **tolerance,
    )


def _numbers(args: argparse.Namespace, dae: Dae | None = None) -> dict[str, float]:
    """Read `-p NAME=VALUE[UNIT]` and `--start-values NAME VALUE ...`."""
    words = args.start_values
    if len(words) % 2:
        raise UsageError(f"--start-values: '{words[-1]}' has no value; give NAME VALUE pairs")
    pairs = [*zip(words[::2], words[1::2], strict=True)]
    for item in args.values:
        name, equals, text = item.partition("=")
        if not equals:
            raise UsageError(f"-p {item}: write NAME=VALUE[UNIT]")
        pairs.append((name, text))
    numbers: dict[str, float] = {}
    for name, text in pairs:
        if name in numbers:
            raise UsageError(f"{name} is given twice; give it once")
        numbers[name] = quantity(text, _variable(dae, name))
    return numbers


def _variable(dae: Dae | None, name: str) -> Variable:
    if dae is None:  # of an FMU: numbers only, in its own units
        return Variable(name, "1", "start value", 0.0)
    try:
        return dae.variable(name)
    except KeyError:
        known = [v.name for v in (*dae.states, *dae.parameters, *dae.inputs)]
        kind = "state, parameter or input"
        raise UnknownName.among(dae.full_name, kind, name, known) from None


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


def _show(args: argparse.Namespace, rows: list[dict[str, Any]]) -> None:
    if args.json:
        print(json.dumps(rows, indent=1))
        return
    if not rows:
        return
    cells = [[_cell(value) for value in row.values()] for row in rows]
    widths = [max(map(len, column)) for column in zip(rows[0], *cells, strict=True)]
    for line in ([*rows[0]], *cells):
        print(
            "  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip()
        )


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return "" if value is None else str(value)


def _write(args: argparse.Namespace, text: str) -> None:
    if args.output_file:
        from cosim.files import write_atomically

        write_atomically(Path(args.output_file), text.encode())
    else:
        sys.stdout.write(text)
