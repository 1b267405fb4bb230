"""`cosim tradeoff MODEL|SCENE.toml`: error against cost as a table, a file and a figure."""

import argparse
import sys
from functools import partial
from typing import Any

from cosim.cli.arguments import names_in, numbers_in, options_in, scene_from, start_texts
from cosim.cli.tables import draw, show_table, write_text
from cosim.coupling.files import is_system, read_system
from cosim.coupling.system import System
from cosim.errors import UsageError
from cosim.fmi.trust import is_made_here
from cosim.study.tradeoff.configuration import Selection
from cosim.study.tradeoff.measurement import COSTS
from cosim.study.tradeoff.result import Tradeoff
from cosim.study.tradeoff.study import tradeoff

_RUN_COLUMNS = (
    *("model", "reduced", "backend", "solver", "tolerance", "step", "error", "worst", "rhs_calls"),
    *("solver_ms", "solver_ms_low", "solver_ms_high", "total_ms", "drift", "pareto"),
)


def run(args: argparse.Namespace) -> int:
    """Measure error against cost."""
    selection = _selection(args)
    co_simulated = is_system(args.model) and selection == Selection(steps=selection.steps)
    named = not args.model.lower().endswith(".toml") and ("/" in args.model or ".py:" in args.model)
    shown = not args.quiet and (args.verbose or sys.stderr.isatty())
    given = dict[str, Any]()
    if co_simulated:
        given = options_in(args, "start_time", "stop_time", "output_interval")
        given["outputs"] = None if args.outputs is None else names_in(args.outputs)
        given["start_values"] = dict(start_texts(args))
    study = tradeoff(
        _own_system(args.model) if co_simulated else scene_from(args),
        selection=selection,
        every_formulation=not named,
        repeats=args.repeats,
        progress=partial(print, file=sys.stderr, flush=True) if shown else None,
        **given,
    )
    if args.output_file:
        text = study.to_json() if args.output_file.lower().endswith(".json") else study.to_csv()
        write_text(args.output_file, text)
    draw(args, "tradeoff" if isinstance(study, Tradeoff) else "methods", study)
    if args.json:
        write_text(None, study.to_json())
    elif isinstance(study, Tradeoff):
        _print(study)
    else:
        show_table(study.rows)
    return 0


def _own_system(path: str) -> System:
    """Read a coupled system whose FMUs may run in this process."""
    system = read_system(path)
    if foreign := [file.name for file in system.fmus if not is_made_here(file)]:
        raise UsageError(
            f"{path}: {foreign[0]} was not exported here; use simulate --method instead"
        )
    return system


def _selection(args: argparse.Namespace) -> Selection:
    """Return what to measure; one relative tolerance is a list of one."""
    names = ("solvers", "backends", "drift_controls")
    chosen: dict[str, Any] = {
        name: names_in(text) for name in names if (text := getattr(args, name))
    }
    for name, unit in (("tolerances", "1"), ("steps", "s")):
        if text := getattr(args, name):
            chosen[name] = tuple(numbers_in(f"--{name}", text, unit))
    if args.relative_tolerance is not None:
        if "tolerances" in chosen:
            raise UsageError(
                "--relative-tolerance and --tolerances both name tolerances to measure; "
                "give one of them"
            )
        chosen["tolerances"] = (args.relative_tolerance,)
    return Selection(**chosen)


def _print(study: Tradeoff) -> None:
    done = [row for row in study.rows() if row["status"] == "complete"]
    control = ("drift_control",) if any(row["drift_control"] for row in done) else ()
    show_table([{key: row[key] for key in (*control, *_RUN_COLUMNS)} for row in done])
    if missing := study.missing():
        print("\nwithout a result")
        show_table(missing)
        print()
    for key, value in study.provenance.items():
        print(f"{key}: {value}")
    for cost in COSTS:
        print(f"\nPareto front, error against {cost} ({'s' if cost == 'solver_time' else '1'})")
        best = [
            {"configuration": str(m.configuration), "error": study.shown_error(m),
             cost: m.cost(cost)}
            for m in study.pareto_front(cost)
        ]  # fmt: skip
        show_table(best)
    if study.orders:
        print("\nobserved order of the fixed-step methods")
        show_table([order.row() for order in study.orders])
        print("\nlargest stable step at the end of the run, from eigenvalues and measured")
        show_table([limit.row() for limit in study.stability])
        if not study.stability:
            print("none: no mode decays, or the motion has not become steady")
