"""`cosim` and `python -m cosim`: the command line."""

import atexit
import os
import signal
import sys


def main(*, own_process: bool = False) -> int:
    """Run the command line; return the exit code.

    Imports take most of the time of a short command: Ctrl-C ends it there, too.

    Args:
        own_process: Whether the process is for nothing else.
    """
    try:
        if own_process:
            from cosim.extensions import load_extensions_whole

            load_extensions_whole()
        from cosim.cli.main import main as run_command_line

        return run_command_line()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def command() -> int:
    """Run the command line as all that this process is for; return the exit code.

    When it is done Ctrl-C has nothing left to end, and only the word of a process that Python is
    leaving would say so. After Ctrl-C, Python itself might end with SIGINT instead of the code: it
    does so if the exception went through an `exec`, as those of dataclasses, though it was handled.
    """
    code = main(own_process=True)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if code == 130:
        atexit._run_exitfuncs()
        sys.stdout.flush()
        os._exit(code)
    return code


if __name__ == "__main__":
    sys.exit(command())
