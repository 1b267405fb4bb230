"""`cosim info MODEL|SCENE.toml|FILE.fmu`: variables with their numbers, size of the equations."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from cosim.cli.options import add_timeout, common

if TYPE_CHECKING:
    from cosim.cli.options import Verbs


def add_parser(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verbs.add_parser(
        "info", parents=[common()], help="variables and equations of a model, a scene, an FMU"
    )
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
