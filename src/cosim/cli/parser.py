"""What the command line takes: verbs and their options."""

import argparse
from importlib.metadata import version
from typing import NoReturn

_DESCRIPTION = (
    "Rigid-body systems as symbolic DAEs: CVODES and IDAS on one road, FMUs on the other."
)
_EXAMPLES = """examples:
  cosim list
  cosim simulate crank_shaft --stop-time 1 --output-file crank.csv
  cosim simulate bicycle -p phi_dot=30deg/s --outputs phi,delta
  cosim export bicycle/multipliers -o bicycle.fmu
  cosim plot bicycle_model_1.toml --output-file bicycle.pdf
  cosim crosscheck crank_shaft bar_on_frame bicycle

exit codes: 0 done, 1 a run failed, 2 wrong usage, 3 unknown name, 4 results differ,
            5 a tool is missing, 130 interrupted"""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line that names the help to read."""

    def error(self, message: str) -> NoReturn:
        """Exit with 2 and say what to read."""
        self.exit(2, f"{self.prog}: {message}; see: {self.prog} --help\n")


def command_line() -> argparse.ArgumentParser:
    """Return the parser of all verbs."""
    parser = Parser(
        prog="cosim",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"cosim {version('cosim-rigid')}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    common = _common()
    run, values = _run_options(), _value_options()

    verbs.add_parser("list", parents=[common], help="every model and formulation")

    info = verbs.add_parser("info", parents=[common], help="variables and equations of a model")
    info.add_argument("model", metavar="MODEL")

    simulate = verbs.add_parser("simulate", parents=[common, run, values], help="one run, as CSV")
    simulate.add_argument("model", metavar="MODEL|SCENE.toml|FILE.fmu")
    _solver_options(simulate)
    simulate.add_argument("--output-file", metavar="FILE", help="CSV; standard output by default")
    _timeout_option(simulate)

    export = verbs.add_parser("export", parents=[common], help="write a model as an FMU")
    export.add_argument("model", metavar="MODEL|SCENE.toml")
    export.add_argument("-o", "--output-file", metavar="FILE.fmu", help="MODEL.fmu by default")
    export.add_argument("--fmi", default="2", metavar="2|3", help="version of FMI; 2")
    export.add_argument(
        "--platform",
        default="native",
        metavar="A,B",
        help="native, linux64, win64, darwin64, aarch64-linux, all; native by default",
    )
    export.add_argument("--outputs", metavar="A,B", help="what to compute; all by default")
    export.add_argument(
        "--solver",
        dest="fmu_solver",
        metavar="NAME",
        help="of co-simulation: dop853 (default), rosenbrock (default of stiff models), erk",
    )
    _accuracy_option(export)

    crosscheck = verbs.add_parser(
        "crosscheck", parents=[common, run], help="the same run on every road, and the differences"
    )
    crosscheck.add_argument("models", metavar="MODEL|SCENE.toml", nargs="*", help="all by default")
    crosscheck.add_argument("--bound", type=float, metavar="B", help="in nominal values; 1e-6")
    _timeout_option(crosscheck)

    tradeoff = verbs.add_parser(
        "tradeoff", parents=[common, run, values], help="error against cost, on every road"
    )
    tradeoff.add_argument("model", metavar="MODEL|SCENE.toml")
    _selection_options(tradeoff)

    extremes = verbs.add_parser(
        "extremes", parents=[common], help="every model at its limits, and how each case ends"
    )
    extremes.add_argument("models", metavar="MODEL", nargs="*", help="all by default")
    extremes.add_argument("--long", action="store_true", help="with hours of simulated time")
    extremes.add_argument(
        "--timeout", type=float, default=120.0, metavar="S", help="for one case, s; 120"
    )
    extremes.add_argument("--output-file", metavar="FILE", help="every case, as CSV")
    extremes.add_argument("--figure", metavar="FILE", help="the map as PNG, SVG or PDF")

    plot = verbs.add_parser(
        "plot", parents=[common, run, values], help="a run as curves, to a window or a file"
    )
    plot.add_argument("model", metavar="MODEL|SCENE.toml|FILE.fmu")
    _solver_options(plot)
    plot.add_argument(
        "--compare",
        metavar="ROAD",
        help="draw a second run and the difference: fmu-me, fmu-cs, a solver, a formulation",
    )
    plot.add_argument("--output-file", metavar="FILE", help="PNG, SVG or PDF; a window by default")
    _timeout_option(plot)
    return parser


def _timeout_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--timeout", type=float, metavar="S", help="for one run of an FMU file, s; no limit"
    )


def _common() -> Parser:
    common = Parser(add_help=False)
    common.add_argument("--json", action="store_true", help="results as JSON")
    common.add_argument("-q", "--quiet", action="store_true", help="no progress")
    common.add_argument("-v", "--verbose", action="store_true", help="say what a run took")
    common.add_argument("--debug", action="store_true", help="show where an error arose")
    return common


def _run_options() -> Parser:
    run = Parser(add_help=False)
    run.add_argument("--stop-time", type=float, metavar="S", help="s; the model's own by default")
    run.add_argument("--output-interval", type=float, metavar="S", help="s; 0.01 by default")
    run.add_argument("--relative-tolerance", type=float, metavar="R", help="error per step")
    return run


def _value_options() -> Parser:
    values = Parser(add_help=False)
    values.add_argument("--start-time", type=float, metavar="S", help="s; 0 by default")
    values.add_argument("--outputs", metavar="A,B", help="what to compute; everything by default")
    values.add_argument(
        "--start-values", nargs="+", default=[], metavar="NAME VALUE", help="in SI units"
    )
    values.add_argument(
        "-p",
        dest="values",
        action="append",
        default=[],
        metavar="NAME=VALUE[UNIT]",
        help="parameter, start value or constant input",
    )
    return values


def _solver_options(parser: argparse.ArgumentParser) -> None:
    _accuracy_option(parser)
    parser.add_argument(
        "--budget", type=float, metavar="MS", help="time of the solver, ms; the best run within it"
    )
    parser.add_argument("--solver", metavar="NAME", help="cvodes, or idas for a DAE, by default")
    parser.add_argument("--absolute-tolerance", type=float, metavar="A", help="error per step, SI")
    parser.add_argument("--step-size", type=float, metavar="S", help="s; of rk4 and ode8")
    parser.add_argument(
        "--interface-type", metavar="KIND", help="of an FMU: ModelExchange or CoSimulation"
    )
    parser.add_argument("--interpreted", action="store_true", help="do not compile the equations")
    parser.add_argument(
        "--on-invalid",
        metavar="ACTION",
        help="where a run leaves the model's limits: warn (the default), stop or ignore",
    )
    parser.add_argument(
        "--drift-control",
        metavar="KIND",
        help="of constraints: none, baumgarte, or projection after every step; the model's own",
    )


def _accuracy_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--accuracy",
        type=float,
        metavar="X",
        help="global error of the outputs in nominal values; chooses solver and tolerance",
    )


def _selection_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--solvers", metavar="A,B", help="all, and the FMU, by default")
    parser.add_argument("--tolerances", metavar="A,B", help="from 1e-2 to 1e-12 by default")
    parser.add_argument("--steps", metavar="A,B", help="s; of rk4 and ode8")
    parser.add_argument("--roads", metavar="A,B", help="native, native-interpreted, fmu-me, fmu-cs")
    parser.add_argument(
        "--drift-controls", metavar="A,B", help="none, baumgarte, projection; the model's own"
    )
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="timed runs; 5")
    parser.add_argument("--resume", action="store_true", help="go on after an interruption")
    parser.add_argument("--output-file", metavar="FILE", help="CSV or JSON, with provenance")
    parser.add_argument("--figure", metavar="FILE", help="PNG, SVG or PDF")
