"""Options that several verbs share. Only `argparse` is needed to understand a command line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import NoReturn

_CHOICE = re.compile(r"invalid choice: '?([^' ]*)'? ")


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line that names the help to read."""

    def error(self, message: str) -> NoReturn:
        """Exit with 2 and say what to read."""
        if (wrong := _CHOICE.search(message)) and self._subparsers is not None:
            message += did_you_mean(wrong[1], self.verbs())
        self.exit(2, f"{self.prog}: {message}; see: {self.prog} --help\n")

    def verbs(self) -> dict[str, Parser]:
        """Return the parsers of all verbs, by name."""
        groups = (a for a in self._actions if isinstance(a, argparse._SubParsersAction))
        return next((dict(group.choices) for group in groups), {})

    def options(self) -> list[str]:
        """Return the names of all options."""
        return [name for action in self._actions for name in action.option_strings]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the hint on the nearest name, or nothing."""
    near = get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def seconds(text: str) -> float:
    """Read a time: a number of seconds, or one with a unit, as 5s, 200ms, 2min."""
    try:
        return float(text)
    except ValueError:
        pass
    from cosim.errors import ParameterError
    from cosim.model.quantities import quantity

    try:
        return quantity("time", text, "s")
    except ParameterError:
        hint = "write a decimal point" if "," in text else "write e.g. 5 or 5s"
        raise argparse.ArgumentTypeError(f"invalid float value: '{text}'; {hint}") from None


def common() -> Parser:
    """Return the options of every verb."""
    parser = Parser(add_help=False)
    parser.add_argument("--json", action="store_true", help="results as JSON")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress")
    parser.add_argument("-v", "--verbose", action="store_true", help="say what a run took")
    parser.add_argument("--debug", action="store_true", help="show where an error arose")
    return parser


def add_run(parser: Parser) -> None:
    """Let a verb run something."""
    parser.add_argument(
        "--stop-time", type=seconds, metavar="S", help="s; the model's own by default"
    )
    parser.add_argument("--output-interval", type=seconds, metavar="S", help="s; 0.01 by default")
    parser.add_argument("--relative-tolerance", type=float, metavar="R", help="error per step")


def add_numbers(parser: Parser) -> None:
    """Let a verb set a model's numbers."""
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


def add_values(parser: Parser) -> None:
    """Let a verb set a model's numbers and choose its outputs."""
    add_outputs(parser)
    add_numbers(parser)


def add_outputs(parser: Parser) -> None:
    """Let a verb choose what it computes, and from when on."""
    parser.add_argument("--start-time", type=seconds, metavar="S", help="s; 0 by default")
    parser.add_argument("--outputs", metavar="A,B", help="what to compute; everything by default")


def add_single_run(parser: Parser) -> None:
    """Let a verb make one run as `cosim simulate` does, of foreign code, too."""
    add_run(parser)
    add_values(parser)
    add_solver(parser)
    add_timeout(parser)
    add_trust(parser)


def add_solver(parser: Parser) -> None:
    """Let a verb choose how one run is integrated."""
    add_accuracy(parser)
    parser.add_argument(
        "--budget", type=float, metavar="MS", help="time of the solver, ms; the best run within it"
    )
    parser.add_argument(
        "--solver",
        metavar="NAME",
        help="cvodes (default of an ODE), cvodes_adams (ode113), idas (default of a DAE), "
        "erk (ode45), rosenbrock, dop853, rk4 (ode4), ode8; ode15s is the default",
    )
    parser.add_argument(
        "--stop-when", metavar="CONDITION", help='end the run there, e.g. "abs(phi) > 45deg"'
    )
    parser.add_argument(
        "--input",
        dest="laws",
        action="append",
        default=[],
        metavar="NAME=FORMULA",
        help='of time t, states and parameters, e.g. "steer_torque=2*sin(3*t)"',
    )
    parser.add_argument("--input-file", metavar="CSV", help="time series of inputs: time,NAME,...")
    add_error_control(parser)
    parser.add_argument(
        "--interface-type", metavar="KIND", help="of an FMU: ModelExchange or CoSimulation"
    )
    parser.add_argument("--interpreted", action="store_true", help="do not compile the equations")
    parser.add_argument(
        "--drift-control",
        metavar="KIND",
        help="of constraints: none, baumgarte, or projection after every step; the model's own",
    )


def add_error_control(parser: Parser) -> None:
    """Let a verb choose how accurate runs are, and what happens where they leave their model."""
    parser.add_argument(
        "--absolute-tolerance", type=float, metavar="A", help="error per step in nominal values"
    )
    parser.add_argument("--step-size", type=seconds, metavar="S", help="s; of rk4 and ode8")
    parser.add_argument(
        "--on-invalid",
        metavar="ACTION",
        help="where a run leaves the model's limits: warn (the default), stop or ignore",
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
        "--timeout", type=seconds, metavar="S", help="for a run of an FMU or a PATH.py, s; no limit"
    )


def add_trust(parser: Parser) -> None:
    """Let a verb run the code of foreign FMUs."""
    parser.add_argument(
        "--trust", action="store_true", help="run this FMU's code, now and in future"
    )


def add_figure(parser: Parser, text: str = "PNG, SVG or PDF") -> None:
    """Let a verb draw its result."""
    parser.add_argument("--figure", metavar="FILE", help=text)


def add_output_file(parser: Parser, metavar: str, text: str, *, required: bool = False) -> None:
    """Let a verb write its result to a file."""
    parser.add_argument("-o", "--output-file", required=required, metavar=metavar, help=text)


def add_picture(parser: Parser, size: str) -> None:
    """Let a verb choose how large its pictures are."""
    parser.add_argument(
        "--size", default=size, metavar="WxH", help=f"inches; {size or 'by what is drawn'}"
    )
    parser.add_argument("--dpi", type=int, default=120, metavar="N", help="dots per inch; 120")
