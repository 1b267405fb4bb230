"""`cosim export MODEL|SCENE.toml -o FILE.fmu`: a model or a scene as an FMU."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from cosim.cli.arguments import names_in, scene_from
from cosim.cli.tables import note
from cosim.coupling.files import is_system, read_system
from cosim.errors import UnknownName, UsageError
from cosim.fmi.export.options import FmuKeywords
from cosim.verify.reference_result import export_with_reference


def run(args: argparse.Namespace) -> int:
    """Write a model or a scene as an FMU, or a coupled system with its FMUs."""
    if (args.output_file or "").lower().endswith(".ssp"):
        return _export_system(args)
    scene = scene_from(args)
    request = scene.request.reduced()
    dae = request.configured()
    name = (dae.full_name if ".py:" in args.model else scene.name).replace("/", "_")
    target, options = args.output_file or f"{name}.fmu", _options(args, name)
    path = export_with_reference(dae, target, reference=args.reference == "auto", **options)
    if args.verbose:
        print(*dae.report, sep="\n", file=sys.stderr)
    if request.inputs is not None:
        names = ", ".join(request.inputs.names)
        note(args, f"{names}: inputs of the FMU; the importer supplies their series")
    return _reported(args, path, model=dae.full_name, report=list(dae.report))


def _reported(args: argparse.Namespace, path: Path, **facts: Any) -> int:
    """Name the file that was written, and return the exit code."""
    size = path.stat().st_size
    if args.json:
        print(json.dumps({"file": str(path), "bytes": size, **facts}))
    note(args, f"{path} ({size / 1000:.0f} kB)")
    return 0


def _export_system(args: argparse.Namespace) -> int:
    """Write a coupled system with the FMUs of its parts."""
    if not is_system(args.model):
        raise UsageError(f"{args.output_file}: .ssp is for coupled systems; write an .fmu file")
    if args.values or args.start_values:
        raise UsageError(
            f"{args.output_file}: -p and --start-values are for a model or a scene; set the values "
            f"in {args.model}"
        )
    return _reported(args, read_system(args.model).write_ssp(args.output_file))


def _options(args: argparse.Namespace, name: str) -> FmuKeywords:
    """Return the options of the export, checked where they are choices."""
    UnknownName.reject("cosim export", "FMI version", ("2", "3"), args.fmi.removesuffix(".0"))
    UnknownName.reject("cosim export", "reference", ("auto", "none"), args.reference)
    about = {name: getattr(args, name) for name in ("author", "license", "date")}
    options: FmuKeywords = {
        "fmi": int(float(args.fmi)),
        "identifier": name,
        "solver": args.fmu_solver,
        "step_size": args.fmu_step_size,
        "max_step": args.fmu_max_step,
        "platforms": names_in(args.platform),
        "adjoint": args.adjoint,
        "derivatives": args.derivatives,
        "valid": args.valid,
        "names": args.names,
        "about": {name: text for name, text in about.items() if text is not None},
    }
    if args.tunable is not None:
        options["tunable"] = () if args.tunable == "none" else names_in(args.tunable)
    if args.tolerance is not None:
        options["tolerance"] = args.tolerance
    return options
