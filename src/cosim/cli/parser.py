"""The command line as a whole: its verbs, each in a file of its name."""

import argparse
from importlib import import_module
from typing import Any

from cosim.cli.completion import PrintCompletion
from cosim.cli.options import Parser, common

# A new verb is a file in `verbs/` and its line here, where `cosim --help` shall show it.
VERBS = {
    "list": "every model and formulation",
    "info": "variables and equations of a model, a scene, an FMU",
    "simulate": "one run, as CSV",
    "export": "write a model as an FMU",
    "check": "what is wrong with an FMU; its code runs with --run only",
    "crosscheck": "the same run on every road, and the differences",
    "tradeoff": "error against cost, on every road",
    "extremes": "every model at its limits, and how each case ends",
    "plot": "runs as curves, to a window or a file",
    "animate": "runs in three dimensions, to a file",
    "report": "everything about one run on one page",
    "sweep": "many runs: tables, grids and designs, over processes or a cluster",
    "sensitivity": "derivatives of a run by parameters and start values, checked by a second "
    "method",
    "linearize": "A, B, C, D and eigenvalues at a start, an equilibrium, a time, or along a "
    "parameter",
    "scene": "a shipped scene as a file, to start from",
    "new": "a model file to start from",
    "cache": "what is kept between runs: how much, or away with it",
}

_DESCRIPTION = (
    "Rigid-body systems as symbolic DAEs: CVODES and IDAS on one road, FMUs on the other."
)
_EXAMPLES = """examples:
  cosim list
  cosim simulate crank_shaft --stop-time 1 -o crank.csv
  cosim simulate bicycle -p phi_dot=30deg/s --outputs phi,delta
  cosim export bicycle/multipliers -o bicycle.fmu
  cosim plot bicycle_model_1.toml -o bicycle.pdf
  cosim animate bicycle -o bicycle.html
  cosim crosscheck crank_shaft bar_on_frame bicycle

exit codes: 0 done, 1 a run failed, 2 wrong usage, 3 unknown name, 4 results differ,
            5 a tool is missing, 130 interrupted"""


def command_line() -> Parser:
    """Return the parser of all verbs; `run` of what it reads is the function to call."""
    parser = Parser(
        prog="cosim",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--version", action=PrintVersion, help="show program's version number and exit"
    )
    parser.add_argument(
        "--print-completion",
        action=PrintCompletion,
        metavar="SHELL",
        help="a script for bash, zsh or fish that completes verbs and options",
    )
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for verb, text in VERBS.items():
        module = import_module(f"cosim.cli.verbs.{verb}")
        own = verbs.add_parser(verb, parents=[common()], help=text)
        module.add_options(own)
        own.set_defaults(run=module.run)
    return parser


class PrintVersion(argparse.Action):
    """An option that prints the version; it is looked up by then only, which takes its time."""

    def __init__(self, option_strings: list[str], dest: str, help: str) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print the version and end."""
        from importlib.metadata import version

        print(f"cosim {version('cosim-rigid')}")
        parser.exit()
