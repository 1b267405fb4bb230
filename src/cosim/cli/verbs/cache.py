"""`cosim cache --info|--clear`: what is kept between runs."""

import argparse
import json
import sys

from cosim.cli.options import Parser


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--info", action="store_true", help="where it is and how large; the default")
    what.add_argument("--clear", action="store_true", help="remove all of it")


def run(args: argparse.Namespace) -> int:
    """Show the cache, or empty it."""
    from cosim.codegen import cache

    if args.clear:
        held = cache.clear()
        if not args.quiet:
            told = f"{held.folder}: removed {held.files} files, {held.size / 1e6:.1f} MB"
            print(told, file=sys.stderr)
        return 0
    held, most = cache.contents(), cache.most_bytes()
    if args.json:
        facts = {"folder": str(held.folder), "files": held.files, "bytes": held.size, "most": most}
        print(json.dumps(facts))
        return 0
    print(
        f"{held.folder}: {held.files} files, {held.size / 1e6:.1f} MB of at most {most / 1e6:g} MB"
    )
    return 0
