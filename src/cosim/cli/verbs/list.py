"""`cosim list`: every model and formulation, and the shipped scenes."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from cosim.cli.options import common

if TYPE_CHECKING:
    from cosim.cli.options import Verbs


def add_parser(verbs: Verbs) -> None:
    """Declare the verb."""
    verbs.add_parser("list", parents=[common()], help="every model and formulation")


def run(args: argparse.Namespace) -> int:
    """Show every model and formulation, and the shipped scenes."""
    import casadi_models
    from cosim.cli.tables import show_table
    from cosim.model.catalogue import load
    from cosim.scene.scene_file import scene_summaries

    models = []
    for name in casadi_models.CATALOG:
        dae = load(name)
        models.append(
            {
                "model": name,
                "states": len(dae.states),
                "algebraics": len(dae.algebraics),
                "parameters": len(dae.parameters),
                "outputs": len(dae.output_variables),
                "description": dae.description,
            }
        )
    scenes = list(scene_summaries())
    if args.json:
        print(json.dumps({"models": models, "scenes": scenes}, indent=1))
        return 0
    show_table(models, as_json=args.json)
    print("\nscenes, for simulate, export, crosscheck and plot")
    show_table(scenes, as_json=args.json)
    return 0
