"""What `supervised` starts: the process in which a user's own code runs."""

import os
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress

from cosim.cli.main import run_words
from cosim.host.inside import look_where_the_parent_does
from cosim.host.processes import die_with_parent


def run_to_its_end(writer: int, words: Sequence[str]) -> None:
    """Run a command line; tell the parent its exit code, and end."""
    die_with_parent()
    look_where_the_parent_does()
    code = 1
    try:
        code = run_words(words)
    except BaseException:  # of --debug
        traceback.print_exc()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    if sys.platform != "win32":
        os.write(writer, bytes([code]))
    os._exit(code)  # whatever threads are left


if __name__ == "__main__":
    run_to_its_end(int(sys.argv[1]), sys.argv[2:])
