"""The command line: arguments to library calls to text.

Only `argparse` is imported before the arguments are understood; CasADi and the others follow
with the verb that needs them.
"""

import argparse
import io
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from cosim.cli.options import Parser, did_you_mean
from cosim.cli.parser import command_line
from cosim.errors import CosimError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `cosim VERB ...`; return the exit code."""
    args = _arguments(arguments)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a name that a terminal cannot show ends no run
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with warnings.catch_warnings():
            if not args.debug:
                warnings.showwarning = _warn
            _refuse_unwritable(args)
            code: int = args.run(args)
        sys.stdout.flush()
        return code
    except CosimError as error:
        if args.debug:
            raise
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if args.debug:
            raise
        told = " ".join(f"{type(error).__name__}: {error}".split())
        print(f"cosim {args.verb} failed with {told}; show where with: --debug", file=sys.stderr)
        return 1


def _arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
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

    for target in (getattr(args, "output_file", None), getattr(args, "figure", None)):
        if target is not None:
            refuse_unwritable(target)


def _warn(message: Warning | str, *_where: Any, **_more: Any) -> None:
    """Print a warning for a user: what it says, without a line of our code."""
    print(f"warning: {message}", file=sys.stderr)
