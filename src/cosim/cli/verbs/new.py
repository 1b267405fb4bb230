"""`cosim new FILE.py|FILE.toml`: a model file, or a copy of a shipped scene, to start from."""

import argparse
from pathlib import Path

from cosim.cli.tables import note, report_files, write_text
from cosim.errors import UnknownName, UsageError
from cosim.files import is_file
from cosim.scene import shipped_scenes
from cosim.text import json_text


def run(args: argparse.Namespace) -> int:
    """Write a model file or a scene; an existing file is not changed."""
    printed = args.file == "-"
    path = Path("pendulum.py" if printed else args.file)
    if args.scene is not None:
        if not printed and path.suffix != ".toml":
            raise UsageError(f"cosim new: {path} cannot hold a scene; give a name like mine.toml")
        text, subject = _scene(args.scene), str(path)
    elif path.suffix == ".toml":
        raise UsageError(f"cosim new: {path} needs a scene to copy; add --from SCENE")
    elif path.suffix != ".py" or not path.stem.isidentifier():
        raise UsageError(
            f"cosim new: {path} cannot hold a model; use letters, digits and _, as in pendulum.py"
        )
    else:
        template = Path(__file__).with_name("pendulum.txt").read_text(encoding="utf-8")
        text, subject = template.format(file=path, name=path.stem), f"{path}:build"
    if not printed and is_file(path):
        raise UsageError(f"cosim new: {path} exists; give another name")
    if printed and args.json:
        text = json_text({"text": text}) + "\n"
    write_text(None if printed else str(path), text)
    if args.json and not printed:
        report_files(args, path)
    elif not printed:
        note(args, f"{path}; run it with: cosim simulate {subject}")
    return 0


def _scene(name: str) -> str:
    """Return the text of a shipped scene."""
    known = {path.stem: path for path in shipped_scenes()}
    name = name.removesuffix(".toml")
    UnknownName.reject("cosim", "scene", known, name)
    return known[name].read_text(encoding="utf-8")
