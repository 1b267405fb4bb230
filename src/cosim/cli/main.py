"""The command line: its parser, and `main`, which runs a verb and returns the exit code."""

from __future__ import annotations

import argparse
import errno
import io
import os
import re
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from cosim.cli.options import Parser, add_options, did_you_mean
from cosim.cli.verbs import ALIASES, VERBS
from cosim.errors import CosimError, meant_elsewhere
from cosim.files import reject_unwritable
from cosim.host.progress import shown_on_terminal
from cosim.host.signals import TimeLimit, ended_by_signals
from cosim.text import described, visible

_OUTPUT_ERRORS = (errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EBADF)
_DESCRIPTION = "Simulate rigid-body systems natively or as FMUs, and compare the results."
_EXAMPLES = Path(__file__).with_name("examples.txt")


class CommandLine(Parser):
    """The parser of `cosim`; it replaces an alias by the words that it stands for."""

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse a command line."""
        words = [*(sys.argv[1:] if args is None else args)]
        if words and words[0] in ALIASES:
            options_first = len(words) > 1 and words[1].startswith("-")
            words[:1] = ALIASES[words[0]][:1] if options_first else ALIASES[words[0]]
        if words and words[0] not in VERBS and not words[0].startswith("-"):
            fitting = [verb for verb in VERBS if words[0] and verb.startswith(words[0])]
            if len(fitting) > 1:
                self.error(f"several verbs begin with '{words[0]}': {', '.join(fitting)}")
            if not fitting:
                other = _OTHER_VERBS.get(words[0])
                hint = f"; write {other}" if other else did_you_mean(words[0], VERBS)
                self.error(f"there is no verb '{words[0]}'{hint}")
            words[:1] = fitting
        return super().parse_known_args(words, namespace)


@cache
def command_line() -> CommandLine:
    """Return the parser of all verbs."""
    parser = CommandLine(
        prog="cosim",
        usage="cosim VERB ...",
        description=f"{_DESCRIPTION}\n\n{_verb_table()}",
        epilog=_EXAMPLES.read_text(encoding="utf-8").rstrip(),
    )
    add = parser.output.add_argument
    add("-h", "--help", action="help", help="print this help, or that of a verb, and exit")
    add("--version", action=PrintVersion, nargs=0, help="print the version and exit")
    add(
        "--print-completion",
        action=PrintCompletion,
        metavar="SHELL",
        help="print a script for bash, zsh, fish, tcsh or powershell that completes verbs and "
        "options, and exit",
    )
    subparsers = parser.add_subparsers(
        dest="verb",
        metavar="VERB",
        required=True,
        parser_class=Parser,
        help=argparse.SUPPRESS,
        prog="cosim",
    )
    for name, verb in VERBS.items():
        examples = "\n".join(f"  {line}" for line in verb.examples)
        own = subparsers.add_parser(
            name, help=verb.summary, description=verb.summary, epilog=f"examples:\n{examples}"
        )
        add_options(own, verb)
        own.usage = own.short_usage()
    return parser


def _verb_table() -> str:
    lines, section = [], ""
    for name, verb in VERBS.items():
        if verb.section != section:
            section = verb.section
            lines += ["", f"{section}:"]
        lines.append(f"  {name:12} {verb.summary}")
    lines.append("\nalso: list (the same as info), scene NAME (prints a shipped scene)")
    return "\n".join(lines).lstrip()


class PrintVersion(argparse.Action):
    """An option that prints the version; it is looked up only then."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print the version and exit."""
        from importlib.metadata import version

        print(f"cosim {version('cosim-rigid')}")
        parser.exit()


class PrintCompletion(argparse.Action):
    """An option that prints the completion script of a shell, which shtab writes."""

    def __call__(
        self, parser: argparse.ArgumentParser, _: argparse.Namespace, shell: Any, *_more: Any
    ) -> None:
        """Print the script and exit."""
        import shtab

        if shell not in shtab.SUPPORTED_SHELLS:
            near = did_you_mean(shell, shtab.SUPPORTED_SHELLS)
            names = near or f"; give one of {', '.join(shtab.SUPPORTED_SHELLS)}"
            parser.exit(3, f"cosim: no shell '{shell}'{names}\n")
        whole = command_line.__wrapped__()  # not the cached parser, as its help is altered
        for action in (a for p in (whole, *whole.verbs().values()) for a in p._actions):
            if isinstance(action, argparse._SubParsersAction):
                action.help = "what to do"  # hidden actions are not completed
            elif action.nargs != 0:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
        print(shtab.complete(whole, shell))
        parser.exit()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `cosim VERB ...`; return the exit code.

    Args:
        arguments: The words after `cosim`. Those of this process when None: then everything that
            foreign FMUs have started ends with the command.
    """
    try:
        try:
            if arguments is not None:
                return _run_words(arguments, own_process=False)
            # else the next files would get the numbers of streams that the caller has closed
            sys.stdin = sys.stdin or os.fdopen(os.open(os.devnull, os.O_RDONLY))
            sys.stdout = sys.stdout or os.fdopen(os.open(os.devnull, os.O_RDONLY), "w")  # fails
            sys.stderr = sys.stderr or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
            with ended_by_signals(command=True):
                return _run_words(sys.argv[1:], own_process=True)
        finally:
            print(end="", flush=True)  # errors of standard output are raised here
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the last flush
        if isinstance(error, BrokenPipeError):  # the reader has ended, as in `cosim info | head`
            return 0
        print(f"cannot write the results: {error.strerror}", file=sys.stderr)
        return 1


def _run_words(words: Sequence[str], *, own_process: bool) -> int:
    args = _parsed(words)
    named = [value for name, value in vars(args).items() if name != "output_file"]
    given = [word for value in named for word in (value if isinstance(value, list) else [value])]
    runs_code = "trust" in args  # which verbs that run the code of files ask for
    foreign = runs_code and any(isinstance(w, str) and w.lower().endswith(".fmu") for w in given)
    args.words = [*words]
    if not foreign or not own_process:
        return _run_verb(args, foreign=foreign)
    from cosim.host.child import ending_orphans

    with ending_orphans():
        return _run_verb(args, foreign=True)


def _parsed(words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line, with the options of the verb that it names."""
    parser = command_line()
    args, unknown = parser.parse_known_args(words)
    if unknown:  # argparse itself would name the help of all verbs
        message = f"cosim {args.verb}: cannot take '{unknown[0]}'"
        message += _hint(unknown[0], words, parser.verbs()[args.verb])
        Parser().exit(2, f"{message}; see: cosim {args.verb} --help\n")
    return args


_OTHER_NAMES = {
    "--sweep": ("--along",),
    "--inputs": ("--input-file", "--input"),  # the keyword of Python's calls
    "--parameters": ("--by", "--free", "-p"),
    "--vary": ("--along", "-p"),
    "--delete": ("--clear",),
}
_OTHER_VERBS = {"run": "simulate", "compare": "crosscheck", "validate": "check"}
_OPERATOR = re.compile(r"[<>=?:&|+*/-]+")
_NUMBER_AND_UNIT = re.compile(r"(?:.*=)?[-+]?[\d.]+ [A-Za-z][\w./*^]*")


def _hint(word: str, words: Sequence[str], verb: Parser) -> str:
    """Return what to write instead of a word that a verb does not take."""
    options = verb.options()
    place = words.index(word) if word in words else 0
    option, before = ["", "", *words][place : place + 2]
    if before.endswith(","):
        return f"; write a list without blanks: {before}{word}"
    if _NUMBER_AND_UNIT.fullmatch(f"{before} {word}"):
        return f"; write the unit without a blank: {before}{word}"
    if _OPERATOR.fullmatch(word):
        return "; write no blanks around it, or put it all in quotes"
    if "=" in word and not word.startswith("-"):
        return f"; repeat the option: -p {word}"
    name = word.partition("=")[0]
    if name in options:
        return "; write it after the verb"
    if others := [other for other in _OTHER_NAMES.get(name, ()) if other in options]:
        return f"; write {' or '.join(others)}"
    if option in verb.options("A,B") and not word.startswith("-"):
        return f"; write a list with commas: {before},{word}"
    keywords = {option.lstrip("-").replace("-", "_"): option for option in options}
    if word.startswith("--") and (meant := meant_elsewhere(name[2:].replace("-", "_"), keywords)):
        return f"; write {keywords[meant[0]]}"
    return did_you_mean(name, options)


def _run_verb(args: argparse.Namespace, *, foreign: bool) -> int:
    """Run a verb within its time limit, which FMU files have for each run; return its exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # an encoding may lack letters of a name
        sys.stdout.reconfigure(errors="backslashreplace")  # no time limit may interrupt this
    seconds = None if foreign else getattr(args, "timeout", None)
    code, limit = None, TimeLimit(seconds)
    with suppress(KeyboardInterrupt), limit:
        code = _reported(args)
    if limit.reached and code != 0:  # it may end in the same moment
        limited = f"did not end within {seconds:g} s and was stopped"
        print(f"cosim {args.verb} {limited}", file=sys.stderr)
        return 1
    if code is None:
        print("interrupted", file=sys.stderr)
        return 130
    return code


def _reported(args: argparse.Namespace) -> int:
    """Run a verb; return its exit code, every error reported in one line."""
    try:
        with warnings.catch_warnings(), shown_on_terminal(args.quiet):
            if not args.debug:
                warnings.showwarning = _warn
            _reject_unwritable(args)
            code: int = import_module(f"cosim.cli.verbs.{args.verb}").run(args)
        return code
    except CosimError as error:
        if args.debug:
            raise
        text = visible(_as_typed(str(error), args), lines=True)
        print(f"{type(error).__name__}: {text}", file=sys.stderr)
        return error.exit_code
    except Exception as error:
        if isinstance(error.__cause__, KeyboardInterrupt):  # as Python 3.11 raises of __set_name__
            raise error.__cause__ from None
        to_output = (
            isinstance(error, OSError) and error.errno in _OUTPUT_ERRORS and not error.filename
        )
        if args.debug or to_output:
            raise
        failed = f"cosim {args.verb} failed with {described(error)}; show where with: --debug"
        print(failed, file=sys.stderr)
        return 1


def _as_typed(text: str, args: argparse.Namespace) -> str:
    """Return a message with the options of the command instead of the keywords of Python."""
    typed = {}
    for action in command_line().verbs()[args.verb]._actions:
        name = action.option_strings[-1] if action.option_strings else ""
        if "-" in name[2:] and getattr(args, action.dest, None) not in (None, action.default):
            typed[name[2:].replace("-", "_")] = name
    return re.sub(r"(?<![\w'(.])[a-z]+(_[a-z]+)+(?![\w'(])", lambda m: typed.get(m[0], m[0]), text)


def _reject_unwritable(args: argparse.Namespace) -> None:
    """Reject files that cannot be written before anything is computed."""
    figure = getattr(args, "figure", None)
    for target in (getattr(args, "output_file", None), figure):
        if target is not None:
            reject_unwritable(target)
    if figure is not None:
        from cosim.plotting import picture_format

        picture_format(figure)


def _warn(message: Warning | str, *_where: Any, **_more: Any) -> None:
    """Print the text of a warning without a line of code."""
    print(f"warning: {message}", file=sys.stderr)
