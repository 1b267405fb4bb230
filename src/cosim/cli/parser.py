"""The command line as a whole: its verbs, each in a file of its name."""

import argparse
from importlib import import_module
from typing import Any

from cosim.cli.completion import PrintCompletion
from cosim.cli.options import Parser

# A new verb is a file in `verbs/` and its name here, where `cosim --help` shall show it.
VERBS = (
    *("list", "info", "simulate", "export", "check", "crosscheck", "tradeoff", "extremes", "plot"),
    *("animate", "report", "sweep", "sensitivity", "linearize", "scene", "new", "cache"),
)

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
    for verb in VERBS:
        module = import_module(f"cosim.cli.verbs.{verb}")
        module.add_parser(verbs)
        verbs.choices[verb].set_defaults(run=module.run)
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
