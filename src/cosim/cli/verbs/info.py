"""`cosim info MODEL|SCENE.toml|FILE.fmu`: variables with their numbers, size of the equations."""

import argparse
import json

from cosim.cli.options import Parser, add_timeout


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    parser.add_argument("model", metavar="MODEL|SCENE.toml|FILE.fmu")
    add_timeout(parser)


def run(args: argparse.Namespace) -> int:
    """Show the variables and the size of the equations."""
    from cosim.cli.running import refuse_timeout
    from cosim.cli.tables import terminal_width
    from cosim.present.info import info

    refuse_timeout(args)
    found = info(args.model)
    print(json.dumps(found.to_dict(), indent=1) if args.json else found.text(terminal_width()))
    return 0
