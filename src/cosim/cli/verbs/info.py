"""`cosim info [SUBJECT]`: a list of all models and scenes, or the facts of one."""

import argparse
from collections.abc import Iterator
from typing import Any

from cosim.cli.tables import show_table, terminal_width
from cosim.model.catalogue import models
from cosim.scene import figures_file, shipped_scenes
from cosim.text import json_text
from cosim.toml_file import read_toml


def run(args: argparse.Namespace) -> int:
    """Show a list, or the variables and the size of the equations."""
    if args.model is None:
        _list(args)
        return 0
    from cosim.coupling.files import is_system, read_system  # these load casadi
    from cosim.present.info import info

    if is_system(args.model):
        system = read_system(args.model)
        if args.json and not system.is_model:
            wires = [[".".join(end) for end in (w.output, w.input)] for w in system.connections]
            parts = {name: part.subject.name for name, part in system.parts.items()}
            print(json_text({"system": system.name, "parts": parts, "connections": wires}))
        elif not args.json:
            print(system, end="\n\n" if system.is_model else "\n")
        if not system.is_model:
            return 0
    found = info(args.model)
    print(json_text(found.to_dict(), indent=1) if args.json else found.text(terminal_width()))
    return 0


def _list(args: argparse.Namespace) -> None:
    rows, scenes = models().rows, list(_scenes())
    if args.json:
        print(json_text({"models": rows, "scenes": scenes}, indent=1))
        return
    show_table(rows)
    print("\nscenes, for simulate, export, crosscheck, tradeoff, plot and info")
    show_table(scenes)


def _scenes() -> Iterator[dict[str, Any]]:
    """Yield the facts of each shipped scene without loading its model."""
    for path in shipped_scenes():
        file = read_toml(path)
        data = file.data
        yield {
            "scene": path.name,
            "model": data["model"],
            "outputs": len(data.get("outputs", ())) or "all",
            "figures": len(figures_file(file).data.get("figures", ())),
            "title": data["title"],
        }
