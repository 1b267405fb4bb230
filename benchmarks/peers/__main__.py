"""Comparison of cosim with other packages (peers) on the same problems, in one run.

    python benchmarks/peers [bicycle] [pendulum]

Prints, as Markdown tables of ratios, the time of a right-hand side, the time of the pendulum's
accelerations, and the time to a given global error. A peer that is not installed is listed with
the reason.
"""

import importlib
import platform
import sys
from collections.abc import Sequence
from datetime import date
from importlib.metadata import version
from types import ModuleType

from entries import Evaluation, Solver
from measure import TARGETS, choose, interleaved, per_call
from problem import Problem, bicycle, pendulum

MODULES = ("cosim", "numba", "scipy", "sundae", "heyoka", "diffrax", "pinocchio", "mujoco")
PROBLEMS = {"bicycle": bicycle, "pendulum": pendulum}
OWN = "cosim"


def main(names: Sequence[str]) -> None:
    """Print the tables of some problems, or of all."""
    unknown = set(names) - set(PROBLEMS)
    if unknown:
        sys.exit(f"no problem {', '.join(unknown)}; there are {', '.join(PROBLEMS)}")
    peers = modules()
    for name in names or PROBLEMS:
        problem = PROBLEMS[name]()
        kinds = ("evaluations",) if name == "bicycle" else ("evaluations", "accelerations")
        offered = [found for kind in kinds for found in _offered(peers, kind, problem)]
        evaluations = [entry for entry in offered if isinstance(entry, Evaluation)]
        right_hand_sides(problem, evaluations)
        offered = _offered(peers, "solvers", problem)
        time_to_error(problem, [entry for entry in offered if isinstance(entry, Solver)])


def modules() -> list[ModuleType]:
    """Import a module for each peer; print which one is missing and why."""
    found = []
    print(f"{date.today()}, Python {platform.python_version()}, {platform.machine()}\n")
    for name in MODULES:
        try:
            module = importlib.import_module(f"with_{name}")
        except ImportError as error:
            print(f"- {name}: SKIPPED, {error}; pip install 'cosim-rigid[benchmarks]'")
            continue
        versions = (f"{package} {version(package)}" for package in module.PACKAGES)
        print(f"- {name}: {', '.join(versions)}")
        found.append(module)
    return found


def right_hand_sides(problem: Problem, evaluations: Sequence[Evaluation]) -> None:
    """Print times per evaluation, relative to the first of cosim."""
    times = per_call(evaluations)
    cells: dict[str, dict[bool, str]] = {}
    own: dict[bool, float] = {}
    for evaluation, time in zip(evaluations, times, strict=True):
        base = own.setdefault(evaluation.one, time)
        row = cells.setdefault(evaluation.name, {})
        row[evaluation.one] = f"{time / base:.2f} ({time * 1e9:.0f} ns)"
    _table(
        f"Right-hand side of {problem.dae.full_name}",
        ("", "many in one call", "one call from Python"),
        [(name, row.get(False, ""), row.get(True, "")) for name, row in cells.items()],
    )


def time_to_error(problem: Problem, solvers: Sequence[Solver]) -> None:
    """Print the time of the cheapest run that meets each target, relative to the best of cosim."""
    choices = {}
    for solver in solvers:
        print(f"{solver.name} ...", file=sys.stderr)
        choices[solver.name] = choose(solver, problem)
    rows = {name: [name] for name in choices}
    units = []
    for target in TARGETS:
        runs = {name: c.runs[target] for name, c in choices.items() if target in c.runs}
        times = dict(zip(runs, interleaved([c.run for c in runs.values()]), strict=True))
        best = min(time for name, time in times.items() if name.startswith(OWN))
        units.append(f"{best * 1e3:.2f} ms")
        for name, row in rows.items():
            met = name in runs
            row.append(
                f"{times[name] / best:.2f} ({runs[name].tolerance:.0e})" if met else "not met"
            )
    for name, row in rows.items():
        row.append(f"{choices[name].preparation:.2g} s")
    _table(
        f"Time to a global error of {problem.dae.full_name}, {problem.grid[-1]:g} s, "
        f"{len(problem.grid)} outputs",
        ("solver", *(f"{target:.0e}" for target in TARGETS), "prepared"),
        list(rows.values()),
    )
    print(f"\n1 is {', '.join(units)}; in brackets the relative tolerance of the run.")
    print(f"Reference: {problem.reference}", flush=True)


def _offered(peers: Sequence[ModuleType], kind: str, problem: Problem) -> list[Evaluation | Solver]:
    """Return the entries of every module that has a function of this kind."""
    return [
        entry for peer in peers if hasattr(peer, kind) for entry in getattr(peer, kind)(problem)
    ]


def _table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    print(f"\n{title}\n")
    for row in (head, ["---"] * len(head), *rows):
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
