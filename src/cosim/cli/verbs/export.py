"""`cosim export MODEL|SCENE.toml -o FILE.fmu`: a model or a scene as an FMU."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.cli.options import Parser, add_accuracy, add_output_file, add_timeout

if TYPE_CHECKING:
    from cosim.verify.repeated_export import ExportNote

# What changes what is told, not what is made
_NO_MATTER = ("verb", "run", "output_file", "quiet", "verbose", "json", "debug")


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    parser.add_argument("model", metavar="MODEL|SCENE.toml")
    add_output_file(parser, "FILE.fmu", "MODEL.fmu by default")
    parser.add_argument("--fmi", default="2", metavar="2|3", help="version of FMI; 2")
    parser.add_argument(
        "--platform",
        default="native",
        metavar="A,B",
        help="native, linux64, win64, darwin64, aarch64-linux, all; native by default",
    )
    parser.add_argument("--outputs", metavar="A,B", help="what to compute; all by default")
    parser.add_argument(
        "--solver",
        dest="fmu_solver",
        metavar="NAME",
        help="of co-simulation: dop853 (default), rosenbrock (default of stiff models), erk",
    )
    parser.add_argument(
        "--tunable",
        metavar="A,B|all|none",
        help="parameters that may change during a run; all but inertias and what starts need",
    )
    parser.add_argument(
        "--adjoint", action="store_true", help="offer adjoint derivatives (FMI 3.0)"
    )
    parser.add_argument(
        "--valid",
        action="store_true",
        help="a Boolean output 'valid': true while every limit of the model holds",
    )
    parser.add_argument(
        "--names",
        default="flat",
        metavar="flat|structured",
        help="fx_A or A.f[1]; cosim knows both; flat by default",
    )
    for name in ("author", "license", "date"):
        parser.add_argument(f"--{name}", metavar="TEXT", help=f"{name} given in the FMU")
    parser.add_argument(
        "--tolerance", type=float, metavar="R", help="that the FMU recommends, relative; 1e-8"
    )
    parser.add_argument(
        "--reference",
        default="auto",
        metavar="auto|none",
        help="a reference result inside, as far as there is one, or none; auto",
    )
    add_accuracy(parser)
    add_timeout(parser)


def run(args: argparse.Namespace) -> int:
    """Write a model or a scene as an FMU."""
    from cosim.verify.repeated_export import repeat_export, words_tell_all

    words = {name: value for name, value in vars(args).items() if name not in _NO_MATTER}
    repeats = words_tell_all(args.model) and args.accuracy is None and args.timeout is None
    made = repeat_export(words, args.output_file) if repeats else None
    path, note = _made(args, words if repeats else None) if made is None else made
    if args.verbose:
        print(*note.report, sep="\n", file=sys.stderr)
    if note.inputs and not args.quiet:
        told = ", ".join(note.inputs)
        print(f"{told}: inputs of the FMU; the importer supplies their series", file=sys.stderr)
    if args.json:
        facts = {"file": str(path), "bytes": path.stat().st_size, "model": note.model}
        print(json.dumps(facts | {"report": list(note.report)}))
    if not args.quiet:
        print(f"{path} ({path.stat().st_size / 1000:.0f} kB)", file=sys.stderr)
    return 0


def _made(args: argparse.Namespace, words: Mapping[str, object] | None) -> tuple[Path, ExportNote]:
    """Export; what is told of it is noted under these words."""
    from cosim.cli.arguments import names_in, scene_from
    from cosim.cli.running import refuse_timeout
    from cosim.errors import UnknownName, UsageError
    from cosim.scene.roads import scene_dae
    from cosim.scene.scene_file import scene_values
    from cosim.verify.kept_export import export_kept
    from cosim.verify.repeated_export import ExportNote, note_export

    refuse_timeout(args)
    if args.fmi not in ("2", "3"):
        raise UnknownName.among("cosim export", "FMI version", args.fmi, ("2", "3"))
    scene = scene_from(args)
    dae = scene_dae(scene)
    name = (dae.full_name if ".py:" in args.model else scene.name).replace("/", "_")
    inputs = tuple(scene.inputs.names) if scene.inputs else ()
    note = ExportNote("", name, dae.full_name, tuple(dae.report), inputs)
    target, accuracy = args.output_file or f"{name}.fmu", scene.settings.accuracy
    options: dict[str, Any] = {"fmi": int(args.fmi), "identifier": name, "solver": args.fmu_solver}
    options |= {"platforms": names_in(args.platform), "adjoint": args.adjoint}
    options |= {"valid": args.valid, "names": args.names}
    given = {name: getattr(args, name) for name in ("author", "license", "date")}
    options["about"] = {name: text for name, text in given.items() if text is not None}
    if args.tunable is not None:
        options["tunable"] = () if args.tunable == "none" else names_in(args.tunable)
    if args.reference not in ("auto", "none"):
        raise UnknownName.among("cosim export", "reference", args.reference, ("auto", "none"))
    if args.tolerance is not None:
        options["tolerance"] = args.tolerance
    if accuracy is None:
        sets = scene_values(scene.dae)
        if scene.values:
            sets[name] = (scene.title or f"values of {scene.name}", dict(scene.values))
        with_proof = args.reference == "auto"
        path, entry = export_kept(dae, target, reference=with_proof, sets=sets, **options)
        if words is not None and entry is not None:
            note_export(words, replace(note, entry=entry))
        return path, note
    from cosim.study.accuracy.fmu import export_accurate

    if args.tolerance is not None or args.reference == "none":
        raise UsageError("--accuracy finds the tolerance and needs a reference; leave them out")
    accurate = export_accurate(dae, target, accuracy, **options)
    if not args.quiet:
        print(accurate, file=sys.stderr)
    return accurate.path, note
