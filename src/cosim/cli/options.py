"""Parsers of verbs. Only `argparse` is needed to understand a command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from difflib import get_close_matches
from math import inf
from pathlib import Path
from typing import Any, NoReturn

from cosim.cli.verbs import Verb


class Parser(argparse.ArgumentParser):
    """A parser with a group of options for each topic; its errors are one line.

    Attributes:
        what, times, solver, output: What to run, the times, the solver and the output.
    """

    def __init__(self, **keywords: Any) -> None:
        form = argparse.RawDescriptionHelpFormatter
        super().__init__(add_help=False, formatter_class=form, **keywords)
        self.what = self.add_argument_group("what to run")
        self.times = self.add_argument_group("times")
        self.solver = self.add_argument_group("solver")
        self.output = self.add_argument_group("output")

    def error(self, message: str) -> NoReturn:
        """Exit with 2 and name the help to read."""
        from cosim.text import readable, visible

        self.exit(2, f"{self.prog}: {readable(visible(message))}; see: {self.prog} --help\n")

    def verbs(self) -> dict[str, Parser]:
        """Return the parsers of all verbs, by name."""
        groups = (a for a in self._actions if isinstance(a, argparse._SubParsersAction))
        return next((dict(group.choices) for group in groups), {})

    def short_usage(self) -> str:
        """Return the usage without the single options."""
        words = []
        for action in self._get_positional_actions():
            name = f"{action.metavar} ..." if action.nargs in ("*", "+") else str(action.metavar)
            words.append(f"[{name}]" if action.nargs in ("*", "?") else name)
        return " ".join([self.prog, *words, "[OPTION ...]"])

    def options(self, metavar: str = "") -> list[str]:
        """Return the names of all options, or of those whose value has a name that begins so."""
        chosen = (a for a in self._actions if str(a.metavar).startswith(metavar))
        return [name for action in chosen for name in action.option_strings]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the hint on the nearest name, or nothing."""
    near = get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def seconds(text: str) -> float:
    """Read a time: a number of seconds, or a number with a unit, as 5s, 200ms, 2min."""
    from cosim.errors import ParameterError
    from cosim.model.quantities import quantity

    try:
        return quantity("time", text, "s")
    except ParameterError:
        hint = "write a decimal point" if "," in text else "write e.g. 5 or 5s"
        raise argparse.ArgumentTypeError(f"invalid float value: '{text}'; {hint}") from None


def _time_limit(text: str) -> float:
    """Read a time limit; `inf` is none."""
    with suppress(ValueError):
        if float(text) == inf:
            return inf
    limit = seconds(text)
    if not limit > 0:  # nor is it nan
        raise argparse.ArgumentTypeError(f"{text} is not a positive time in seconds")
    return limit


def _subject(name: str) -> str:
    """Return a model, or the file of a shipped scene also by its bare name."""
    from cosim.scene import shipped_scenes

    if name in {file.stem for file in shipped_scenes()}:
        from casadi_models import CATALOG

        return name if any(e.partition("/")[0] == name for e in CATALOG) else f"{name}.toml"
    return name


TYPES: dict[str, Callable[[str], Any]] = {
    "subject": _subject,
    "float": float,
    "int": int,
    "seconds": seconds,
    "time_limit": _time_limit,
}


_PICTURES = (".png", ".svg", ".pdf")
METAVARS = {"int": "N", "seconds": "S", "time_limit": "S"}  # where an option has no other


def _file_name(endings: Sequence[str], drawn: bool) -> Callable[[str], str]:
    """Return the type of an option for the name of a file that has one of the endings, or none.

    `drawn`: whether the verb writes figures by another option.
    """

    def checked(name: str) -> str:
        known, ending = " or ".join(endings), Path(name).suffix.lower()
        if name == "-":
            hint = f"give a name with {known}, or leave the option out"
            raise argparse.ArgumentTypeError(f"- names no file; {hint}")
        if (ending or name.endswith(".")) and ending not in endings:  # Python 3.14 calls it "."
            hint = f", or draw with --figure {name}" if drawn and ending in _PICTURES else ""
            raise argparse.ArgumentTypeError(f"{name}: give a name with {known}{hint}")
        return name

    return checked


def add_options(parser: Parser, verb: Verb) -> None:
    """Add the options of a verb and `--help`."""
    exclusive: argparse._MutuallyExclusiveGroup | None = None
    for name, fields in verb.options.items():
        keywords = {"help": argparse.SUPPRESS, **fields}  # without a text, an option is hidden
        group = getattr(parser, keywords.pop("topic"))
        flags = keywords.pop("flags", [f"--{name.replace('_', '-')}"])
        if keywords.pop("positional", False):
            flags = [name]
        else:
            keywords["dest"] = name
        if "type" in keywords:
            keywords.setdefault("metavar", METAVARS.get(keywords["type"]))
            keywords["type"] = TYPES[keywords["type"]]
        if "endings" in keywords:
            keywords["type"] = _file_name(keywords.pop("endings"), "figure" in verb.options)
        if keywords.keys().isdisjoint({"type", "metavar", "action"}):
            keywords["action"] = "store_true"
        if name in verb.exclusive:
            group = exclusive = exclusive or group.add_mutually_exclusive_group()
        group.add_argument(*flags, **keywords)
    parser.output.add_argument("-h", "--help", action="help", help="print this help and exit")
