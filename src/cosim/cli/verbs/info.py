"""`cosim info MODEL`: the variables and the size of the equations."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

from cosim.cli.options import add_timeout, common

if TYPE_CHECKING:
    from casadi_models.dae import Variable
    from cosim.cli.options import Verbs


def add_parser(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verbs.add_parser("info", parents=[common()], help="variables and equations of a model")
    parser.add_argument("model", metavar="MODEL")
    add_timeout(parser)


def run(args: argparse.Namespace) -> int:
    """Show the variables and the size of the equations."""
    from cosim.cli.running import refuse_timeout
    from cosim.cli.tables import show_table
    from cosim.integrate.inspection import inspect_start
    from cosim.model.catalogue import load

    refuse_timeout(args)
    dae = load(args.model)
    groups = {
        "states": dae.states,
        "algebraic unknowns": dae.algebraics,
        "inputs": dae.inputs,
        "parameters": dae.parameters,
        "outputs": dae.output_variables,
    }
    facts = {
        "model": dae.full_name,
        "description": dae.description,
        "source": dae.source,
        "span": f"0 ... {dae.experiment.stop_time:g} s",
        "equations": f"{len(dae.states)} differential, {len(dae.algebraics)} algebraic, "
        f"{dae.operations()} scalar operations",
    }
    limits = [meaning for _, meaning in dae.limits]
    start = inspect_start(dae)
    conditions = [
        {"name": v.name, "at the start": value, "meaning": v.meaning}
        for (v, _), value in zip(dae.monitors, start.monitors, strict=True)
    ]
    if args.json:
        tables: dict[str, Any] = {key: [*map(_facts, group)] for key, group in groups.items()}
        tables |= {"conditions": conditions, "limits": limits, "margins": start.margins}
        print(json.dumps(facts | tables, indent=1))
        return 0
    for key, value in facts.items():
        print(f"{key:12} {value}")
    for key, group in groups.items():
        if group:
            print(f"\n{key}")
            show_table([_facts(v) for v in group], as_json=args.json)
    if conditions:
        print("\nconditions: calculated where --outputs names them")
        show_table(conditions, as_json=False)
    if limits:
        print("\nlimits: a run is valid while a margin is positive")
        margins = zip(start.margins, limits, strict=True)
        show_table([{"at the start": m, "meaning": text} for m, text in margins], as_json=False)
    return 0


def _facts(variable: Variable) -> dict[str, Any]:
    from casadi_models.dae import Start

    kind = variable.start_kind
    start = "" if variable.start is None else f"{variable.start:.10g}"
    note = {Start.EXACT: start, Start.CALCULATED: "calculated", Start.GUESS: f"guess {start}"}[kind]
    bounds = (variable.minimum, variable.maximum)
    finite = bounds != (float("-inf"), float("inf"))
    return {
        "name": variable.name,
        "unit": variable.unit,
        "shown in": variable.display_unit or variable.unit,
        "start": note,
        "bounds": f"{bounds[0]:g} ... {bounds[1]:g}" if finite else "",
        "meaning": variable.meaning,
    }
