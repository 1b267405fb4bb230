"""`cosim` and `python -m cosim`: the command line."""

import signal
import sys


def main() -> int:
    """Run the command line; return the exit code.

    Imports take most of the time of a short command: Ctrl-C ends it there, too. When all is done
    it has nothing left to end, and only the word of a process that Python is leaving would say so.
    """
    try:
        from cosim.cli.main import main as command

        code = command()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = 130
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return code


if __name__ == "__main__":
    sys.exit(main())
