"""Options that several verbs share. Only `argparse` is needed to understand a command line."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    Verbs = argparse._SubParsersAction["Parser"]


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line that names the help to read."""

    def error(self, message: str) -> NoReturn:
        """Exit with 2 and say what to read."""
        self.exit(2, f"{self.prog}: {message}; see: {self.prog} --help\n")


def common() -> Parser:
    """Return the options of every verb."""
    parser = Parser(add_help=False)
    parser.add_argument("--json", action="store_true", help="results as JSON")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress")
    parser.add_argument("-v", "--verbose", action="store_true", help="say what a run took")
    parser.add_argument("--debug", action="store_true", help="show where an error arose")
    return parser


def run_options() -> Parser:
    """Return the options of every verb that runs something."""
    parser = Parser(add_help=False)
    parser.add_argument(
        "--stop-time", type=float, metavar="S", help="s; the model's own by default"
    )
    parser.add_argument("--output-interval", type=float, metavar="S", help="s; 0.01 by default")
    parser.add_argument("--relative-tolerance", type=float, metavar="R", help="error per step")
    return parser


def value_options() -> Parser:
    """Return the options that set a model's numbers and choose its outputs."""
    parser = Parser(add_help=False)
    parser.add_argument("--start-time", type=float, metavar="S", help="s; 0 by default")
    parser.add_argument("--outputs", metavar="A,B", help="what to compute; everything by default")
    parser.add_argument(
        "--start-values", nargs="+", default=[], metavar="NAME VALUE", help="in SI units"
    )
    parser.add_argument(
        "-p",
        dest="values",
        action="append",
        default=[],
        metavar="NAME=VALUE[UNIT]",
        help="parameter, start value or constant input",
    )
    return parser


def add_solver(parser: Parser) -> None:
    """Let a verb choose how one run is integrated."""
    add_accuracy(parser)
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


def add_accuracy(parser: Parser) -> None:
    """Let a verb ask for an error instead of a solver and a tolerance."""
    parser.add_argument(
        "--accuracy",
        type=float,
        metavar="X",
        help="global error of the outputs in nominal values; chooses solver and tolerance",
    )


def add_timeout(parser: Parser) -> None:
    """Let a verb end the run of an FMU file or of a user's own code."""
    parser.add_argument(
        "--timeout", type=float, metavar="S", help="for a run of an FMU or a PATH.py, s; no limit"
    )


def add_trust(parser: Parser) -> None:
    """Let a verb run the code of foreign FMUs."""
    parser.add_argument(
        "--trust", action="store_true", help="run this FMU's code, now and in future"
    )


def add_output_file(parser: Parser, metavar: str, text: str) -> None:
    """Let a verb write its result to a file."""
    parser.add_argument("-o", "--output-file", metavar=metavar, help=text)
