"""The command line: arguments to library calls to text.

Only `argparse` is imported before the arguments are understood; CasADi and the others follow
with the verb that needs them.
"""

import argparse
import io
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from typing import Any

from cosim.cli.options import Parser, did_you_mean
from cosim.cli.parser import command_line
from cosim.cli.streams import NO_ROOM, flushed, mend_streams
from cosim.errors import CosimError
from cosim.host.processes import ending_orphans
from cosim.host.processor_time import OutOfTime, limited_time
from cosim.host.progress import shown_on_terminal
from cosim.text.escaping import sentence, visible


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `cosim VERB ...`; return the exit code."""
    if arguments is not None:
        return _run_verb(_parsed_command(arguments))
    mend_streams()
    with limited_time() as told:
        code = _command(sys.argv[1:])
    if told:
        os._exit(flushed(_out_of_time(told[0])))  # native code may run on
    return flushed(code)


def _command(words: Sequence[str]) -> int:
    """Run a command line, in a process of its own where a user's program belongs to it."""
    try:
        args = _parsed_command(words)
        from cosim.cli.supervised import names_own_code, supervised  # a help needs none of it

        if (own := next(filter(names_own_code, _named_words(args)), None)) is not None:
            what = f"cosim {args.verb}: {own}"
            return supervised(words, what, getattr(args, "timeout", None))
        foreign = any(word.endswith(".fmu") for word in _named_words(args))
        with ending_orphans() if foreign else nullcontext():
            return _run_verb(args)
    except SystemExit as ended:  # of argparse
        return ended.code if isinstance(ended.code, int) else 2
    except KeyboardInterrupt as error:
        return _interrupted(error)


def run_words(words: Sequence[str]) -> int:
    """Run a command line in a process that is supervised; return its exit code."""
    mend_streams()
    with limited_time() as told:
        code = _run_verb(_parsed_command(words))
    return flushed(_out_of_time(told[0]) if told else code)


def _out_of_time(told: str) -> int:
    print(f"cosim: {told}", file=sys.stderr)
    return 1


def _named_words(args: argparse.Namespace) -> Iterator[str]:
    """Yield what a command line names: models above all."""
    for value in vars(args).values():
        yield from (w for w in (value if isinstance(value, list) else [value]) if type(w) is str)


def _run_verb(args: argparse.Namespace) -> int:
    """Run a verb; return its exit code, every error told in a sentence."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # a name that a terminal cannot show ends no run
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with warnings.catch_warnings():
            if not args.debug:
                warnings.showwarning = _warn
            _refuse_unwritable(args)
            with shown_on_terminal(args.quiet):
                code: int = args.run(args)
        sys.stdout.flush()
        return code
    except CosimError as error:
        if args.debug:
            raise
        told = visible(str(error), lines=True)
        print(f"{type(error).__name__}: {told}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt as error:
        return _interrupted(error)
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if args.debug:
            raise
        if isinstance(error, OSError) and error.errno in NO_ROOM and error.filename is None:
            print(f"cannot write the results: {error.strerror}", file=sys.stderr)
            return 1
        told = sentence(f"{type(error).__name__}: {error}")
        print(f"cosim {args.verb} failed with {told}; show where with: --debug", file=sys.stderr)
        return 1


def _interrupted(error: KeyboardInterrupt) -> int:
    if not isinstance(error, OutOfTime):  # which is told in the end
        print("interrupted", file=sys.stderr)
    return 130


def _parsed_command(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = command_line()
    args, unknown = parser.parse_known_args(arguments)
    if unknown:  # argparse itself would point to the help of all verbs
        word = unknown[0].partition("=")[0]
        near = did_you_mean(word, parser.verbs()[args.verb].options())
        told = f"cosim {args.verb}: cannot take '{unknown[0]}'{near}"
        Parser().exit(2, f"{told}; see: cosim {args.verb} --help\n")
    return args


def _refuse_unwritable(args: argparse.Namespace) -> None:
    """Refuse files that cannot be written before anything is computed for them."""
    from cosim.files import refuse_unwritable

    figure = getattr(args, "figure", None)
    for target in (getattr(args, "output_file", None), figure):
        if target is not None:
            refuse_unwritable(target)
    if figure is not None:
        from cosim.present.picture_files import picture_format

        picture_format(figure)


def _warn(message: Warning | str, *_where: Any, **_more: Any) -> None:
    """Print a warning for a user: what it says, without a line of our code."""
    print(f"warning: {message}", file=sys.stderr)
