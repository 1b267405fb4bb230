"""`cosim scene NAME`: a shipped scene, to read or to start from."""

import argparse

from cosim.cli.options import Parser, add_output_file


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    parser.add_argument("name", metavar="NAME")
    add_output_file(parser, "FILE.toml", "standard output by default")


def run(args: argparse.Namespace) -> int:
    """Print a shipped scene."""
    from cosim.cli.tables import write_text
    from cosim.errors import UnknownName
    from cosim.scene.library import shipped_scenes

    known = {path.stem: path for path in shipped_scenes()}
    name = args.name.removesuffix(".toml")
    if name not in known:
        raise UnknownName.among("cosim", "scene", name, known)
    write_text(args.output_file, known[name].read_text(encoding="utf-8"))
    return 0
