"""Errors of the examples and of IDAS with and without algebraic unknowns in its error control.

python benchmarks/examples.py           prints the tables
python benchmarks/examples.py --write   puts them into results: examples.md, solvers.md
"""

import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

# The oracles are a module of the tests, which the path above makes importable
from helpers import example_oracles as oracles  # noqa: E402 (after the path)

import casadi_models  # noqa: E402 (after the path)
import cosim  # noqa: E402 (after the path)
from casadi_models.dae import Dae  # noqa: E402 (after the path)
from cosim.errors import CosimError  # noqa: E402 (after the path)
from cosim.host.temporary import temporary_folder  # noqa: E402 (after the path)
from cosim.solvers import Idas  # noqa: E402 (after the path)
from cosim.verify.reference import reference  # noqa: E402 (after the path)

REFERENCES = {
    "andrews": "published, t = 0.03",
    "car_axis": "published, t = 3",
    "pendulum_a01": "elliptic functions",
    "four_bars_a02": "one equation for all cranks",
    "slider_crank_3d": "one equation for the crank",
    "heavy_top": "steady precession",
    "furuta": "Lagrange's equations",
    "quadrotor": "lift and turn in closed form",
    "robertson": "published, t = 40",
    "hires": "published, t = 321.8",
    "van_der_pol": "published, t = 2",
    "heat": "its slowest mode",
    "chain": "Lagrange's equations",
}
DEFAULT = {"four_bars_a02": {"compiled": None}}  # projection needs a compiler
PROJECTED = {"solver": "dop853", "drift_control": "projection"}  # for singular configurations
TIGHT = {"four_bars_a02": PROJECTED, "heat": {}}
NAMES = {"dop853": "`dop853`, projected", "rosenbrock": "`rosenbrock`"}


def examples() -> Iterator[tuple[Dae, dict[str, float]]]:
    """Yield every example with its exact final values."""
    for name, oracle in oracles.ORACLES.items():
        yield cosim.load(f"{ROOT / 'examples' / name}.py:build"), oracle()


def formulations() -> Iterator[tuple[Dae, dict[str, float]]]:
    """Yield every formulation with the final values of its reference."""
    for name in casadi_models.CATALOG:
        dae = cosim.load(name)
        best = reference(dae).run
        yield dae, {v.name: best[v.name][-1] for v in (*dae.states, *dae.algebraics)}


def error(dae: Dae, run: cosim.Trajectory, ends: dict[str, float]) -> float:
    """Return the largest error at the end, relative to value and nominal value."""
    sizes = {variable.name: variable.nominal for variable in dae.variables}
    return max(abs(run[n][-1] - v) / max(sizes[n], abs(v)) for n, v in ends.items())


def cell(dae: Dae, ends: dict[str, float], *, steps: bool = False, **settings) -> str:
    """Return the error of a run, or the time at which it stopped or became invalid."""
    try:
        run = cosim.simulate(dae, **({"compiled": False} | settings))
    except CosimError as failure:
        partial = failure.partial
        return f"stops at {partial.time[-1]:.3g} s" if partial is not None else "no initial state"
    if run.stats.get("invalid"):
        return f"invalid from {run.stats['invalid_from']:.3g} s"
    count = f"{run.stats['steps']}, " if steps else ""
    return f"{count}{error(dae, run, ends):.0e}".replace("e-0", "e-")


def fmu_cell(dae: Dae, ends: dict[str, float], path: Path, interface: str) -> str:
    stop = dae.experiment.stop_time
    settings = {"interface": interface, "stop_time": stop}
    settings |= {"relative_tolerance": 1e-9, "output_interval": stop / 100}
    try:
        run = cosim.simulate_fmu(path, **settings)
    except CosimError as failure:
        at = re.search(r"(?:t = |after |at |time )([\d.]+)", str(failure))
        return f"stops at {float(at[1].rstrip('.')):.2g} s" if at else "stops early"
    return f"{error(dae, run, ends):.0e}".replace("e-0", "e-")


def errors_of_examples() -> str:
    head = "| example | reference | default | 1e-10, default solver | 1e-10 | FMU, ME | FMU, CS |"
    lines = [head, "|---|---|---|---|---|---|---|"]
    for dae, ends in examples():
        name = dae.name
        best = TIGHT.get(name, {"solver": "rosenbrock"})
        compiled = {"compiled": True} if best.get("solver") == "dop853" else {}
        tight = cell(dae, ends, relative_tolerance=1e-10, **best, **compiled)
        with temporary_folder() as folder:
            path = cosim.export_fmu(dae, Path(folder) / f"{name}.fmu")
            fmus = [fmu_cell(dae, ends, path, i) for i in ("ModelExchange", "CoSimulation")]
        row = [
            f"`{name}`",
            REFERENCES[name],
            cell(dae, ends, **DEFAULT.get(name, {})),
            cell(dae, ends, relative_tolerance=1e-10, **DEFAULT.get(name, {})),
            f"{tight} {NAMES.get(best.get('solver', ''), '')}".strip(),
            *fmus,
        ]
        lines.append(f"| {' | '.join(row)} |")
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)


def without_nominal(dae: Dae) -> Dae:
    """Return a model without nominal values, so that tolerances are in SI units."""
    plain = [tuple(replace(v, nominal=1.0) for v in of) for of in (dae.states, dae.algebraics)]
    return replace(dae, states=plain[0], algebraics=plain[1])


def nominal_values() -> str:
    lines = ["| model | 1e-8, SI | 1e-8, nominal | 1e-10, SI | 1e-10, nominal |"]
    lines += ["|---|---|---|---|---|"]
    for dae, ends in (*examples(), *formulations()):
        sizes, row = [v.nominal for v in (*dae.states, *dae.algebraics)], [f"`{dae.full_name}`"]
        if set(sizes) == {1.0} and not dae.algebraics:
            continue
        for tolerance in (1e-8, 1e-10):
            si = {"relative_tolerance": tolerance, "absolute_tolerance": 0.01 * tolerance}
            row.append(si_cell(dae, ends, **si))
            row.append(cell(dae, ends, steps=True, solver="ode15s", relative_tolerance=tolerance))
        lines.append(f"| {' | '.join(row)} |")
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)


def si_cell(dae: Dae, ends: dict[str, float], **settings) -> str:
    try:
        run = cosim.simulate(without_nominal(dae), compiled=False, **settings)
    except CosimError as failure:
        return f"stops at {failure.partial.time[-1]:.3g} s"
    return f"{run.stats['steps']}, {error(dae, run, ends):.0e}".replace("e-0", "e-")


def algebraic_errors() -> str:
    lines = ["| DAE | 1e-8 | without | 1e-10 | without |", "|---|---|---|---|---|"]
    for dae, ends in (*examples(), *formulations()):
        if not dae.algebraics:
            continue
        row = [f"`{dae.full_name}`"]
        for tolerance in (1e-8, 1e-10):
            for suppress in (False, True):
                solver = Idas(relative_tolerance=tolerance, suppress_algebraic=suppress)
                row.append(cell(dae, ends, steps=True, solver=solver))
        lines.append(f"| {' | '.join(row)} |")
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)


TABLES = {
    "errors of examples": ("benchmarks/results/examples.md", errors_of_examples),
    "nominal values": ("benchmarks/results/solvers.md", nominal_values),
    "algebraic errors": ("benchmarks/results/solvers.md", algebraic_errors),
}


def main() -> None:
    for title, (page, make) in TABLES.items():
        table = make()
        print(f"\n{title}\n\n{table}")
        if "--write" in sys.argv:
            path = ROOT / page
            begin, end = f"<!-- {title} -->", f"<!-- end of {title} -->"
            before, _, rest = path.read_text().partition(begin)
            _, _, after = rest.partition(end)
            path.write_text(f"{before}{begin}\n\n{table}\n\n{end}{after}")


if __name__ == "__main__":
    main()
