"""`cosim list`: every model and formulation, and the shipped scenes."""

import argparse
import json

from cosim.cli.options import Parser


def add_options(parser: Parser) -> None:
    """Take no option of its own."""


def run(args: argparse.Namespace) -> int:
    """Show every model and formulation, and the shipped scenes."""
    from cosim.cli.tables import show_table
    from cosim.model.summary import summary
    from cosim.scene.library import scene_summaries

    models, scenes = summary(), list(scene_summaries())
    if args.json:
        print(json.dumps({"models": models, "scenes": scenes}, indent=1))
        return 0
    show_table(models, as_json=False)
    print("\nscenes, for simulate, export, crosscheck, tradeoff, plot and info")
    show_table(scenes, as_json=False)
    return 0
