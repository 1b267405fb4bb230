"""The verb `cosim tradeoff`: error against cost as a table, a file and a figure."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.cli.options import Parser, add_figure, add_output_file, add_run, add_timeout, add_values

if TYPE_CHECKING:
    from cosim.study.tradeoff.configuration import Selection
    from cosim.study.tradeoff.result import Tradeoff

_RUN_COLUMNS = (
    *("model", "reduced", "road", "solver", "tolerance", "step", "error", "worst", "rhs_calls"),
    *("solver_ms", "solver_ms_low", "solver_ms_high", "total_ms", "drift", "front"),
)


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    add_run(parser)
    add_values(parser)
    parser.add_argument("model", metavar="MODEL|SCENE.toml")
    parser.add_argument("--solvers", metavar="A,B", help="all, and the FMU, by default")
    parser.add_argument("--tolerances", metavar="A,B", help="from 1e-2 to 1e-12 by default")
    parser.add_argument("--steps", metavar="A,B", help="s; of rk4 and ode8")
    parser.add_argument("--roads", metavar="A,B", help="native, native-interpreted, fmu-me, fmu-cs")
    parser.add_argument(
        "--drift-controls", metavar="A,B", help="none, baumgarte, projection; the model's own"
    )
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="timed runs; 5")
    parser.add_argument("--resume", action="store_true", help="go on after an interruption")
    add_output_file(parser, "FILE", "CSV or JSON, with provenance")
    add_timeout(parser)
    add_figure(parser)
    parser.add_argument(
        "--all",
        dest="everything",
        action="store_true",
        help="every run in the figure, not only the front and the best of each solver",
    )


def run(args: argparse.Namespace) -> int:
    """Measure error against cost."""
    from cosim.cli.arguments import scene_from
    from cosim.cli.running import refuse_timeout
    from cosim.errors import UnknownName
    from cosim.study.tradeoff.study import tradeoff

    refuse_timeout(args)
    ending = Path(args.output_file).suffix if args.output_file else ".csv"
    if ending not in (".csv", ".json"):
        raise UnknownName.among(args.output_file, "file format", ending, (".csv", ".json"))
    selection, scene = _selection(args), scene_from(args)
    named = not args.model.endswith(".toml") and ("/" in args.model or ".py:" in args.model)

    shown = not args.quiet and (args.verbose or sys.stderr.isatty())

    def tell(line: str) -> None:
        if shown:
            print(line, file=sys.stderr, flush=True)

    try:
        study = tradeoff(
            scene,
            selection=selection,
            every_formulation=not named,
            repeats=args.repeats,
            resume=args.resume,
            tell=tell,
        )
    except KeyboardInterrupt:
        print("what has run is kept; go on with: --resume", file=sys.stderr)
        raise
    _deliver_study(args, study)
    return 0


def _selection(args: argparse.Namespace) -> Selection:
    """Return what to measure; one relative tolerance is a list of one."""
    from cosim.cli.arguments import names_in, numbers_in
    from cosim.errors import UsageError
    from cosim.study.tradeoff.configuration import Selection

    names = ("solvers", "roads", "drift_controls")
    chosen: dict[str, Any] = {
        name: names_in(text) for name in names if (text := getattr(args, name))
    }
    for name in ("tolerances", "steps"):
        if text := getattr(args, name):
            chosen[name] = numbers_in(f"--{name}", text)
    if args.relative_tolerance is not None:
        if "tolerances" in chosen:
            raise UsageError(
                "--relative-tolerance and --tolerances both say at which tolerance to measure; "
                "give one of them"
            )
        chosen["tolerances"] = (args.relative_tolerance,)
    return Selection(**chosen)


def _deliver_study(args: argparse.Namespace, study: Tradeoff) -> None:
    from cosim.cli.tables import write_text

    if args.output_file:
        text = study.to_csv() if args.output_file.endswith(".csv") else study.to_json()
        write_text(args.output_file, text)
    if args.figure:
        from cosim.present.picture_files import save
        from cosim.present.work_precision import draw_tradeoff
        from cosim.present.work_precision_front import draw_front

        draw = draw_tradeoff if args.everything else draw_front
        save([draw(study)], args.figure)
    if args.json:
        write_text(None, study.to_json())
    else:
        _print(study)


def _print(study: Tradeoff) -> None:
    from cosim.cli.tables import show_table
    from cosim.study.tradeoff.measurement import COSTS

    done = [row for row in study.rows() if row["status"] == "complete"]
    control = ("drift_control",) if any(row["drift_control"] for row in done) else ()
    show_table(
        [{key: row[key] for key in (*control, *_RUN_COLUMNS)} for row in done], as_json=False
    )
    if missing := study.missing():
        print("\nwithout a result")
        show_table(missing, as_json=False)
        print()
    for key, value in study.provenance.items():
        print(f"{key}: {value}")
    for cost in COSTS:
        print(f"\nPareto front, error against {cost} ({'s' if cost == 'solver_time' else '1'})")
        front = study.front(cost)
        errors = (max(m.known_error, study.floor) for m in front)
        points = zip(front, errors, strict=True)
        show_table(
            [
                {"configuration": str(m.configuration), "error": e, cost: m.cost(cost)}
                for m, e in points
            ],
            as_json=False,
        )
    print("\nerror = constant * tolerance ** slope")
    show_table([fit.row() for fit in study.proportionality()], as_json=False)
    if study.orders:
        print("\nobserved order of the fixed-step methods")
        show_table([order.row() for order in study.orders], as_json=False)
        print("\nlargest stable step at the end of the run, from eigenvalues and measured")
        show_table([limit.row() for limit in study.stability], as_json=False)
        if not study.stability:
            print("none: no mode decays, or the motion has not become steady")
