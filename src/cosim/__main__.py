"""`cosim` and `python -m cosim`: the command line."""

import sys


def main() -> int:
    """Run the command line; return the exit code.

    Imports take most of the time of a short command: Ctrl-C ends it there, too.
    """
    try:
        from cosim.cli.main import main as command
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    return command()


if __name__ == "__main__":
    sys.exit(main())
