"""Cost of `simulate` outside its solver: the bicycle, dop853 at an error of 1e-7, 2001 outputs.

The cases are all outputs, two states, and two states without validity conditions. Times are CPU
times of interleaved repeats, of which the fastest tenth counts; compare the ratios. The number of
Python function calls does not depend on the load of the machine.
"""

import cProfile
import pstats
from time import thread_time

import numpy as np

import cosim

CASES = {
    "all outputs": {},
    "two outputs": {"outputs": ["phi", "delta"]},
    "two outputs, validity ignored": {"outputs": ["phi", "delta"], "on_invalid": "ignore"},
}
REPEATS = 300
TOLERANCE = 6e-10  # gives an error of the states of 1e-7 nominal values


def main() -> None:
    dae = cosim.load("bicycle")
    solver = cosim.solvers.Dop853(relative_tolerance=TOLERANCE)
    print(f"largest error of a state: {error_of(dae, solver):.1g}")
    wall: dict[str, list[float]] = {name: [] for name in CASES}
    solve: dict[str, list[float]] = {name: [] for name in CASES}
    for _ in range(REPEATS):
        for name, options in CASES.items():
            began = thread_time()
            run = cosim.simulate(dae, solver=solver, **options)
            wall[name].append(thread_time() - began)
            solve[name].append(run.stats["solve_time"])
    for name in CASES:
        whole, inner = (np.quantile(times[name], 0.1) for times in (wall, solve))
        print(f"{name:28} {whole * 1e3:5.2f} ms, {whole / inner:.2f} times the solver's "
              f"{inner * 1e3:.2f} ms, {calls_of(dae, solver, CASES[name])} calls")  # fmt: skip


def error_of(dae: cosim.Dae, solver: cosim.solvers.Dop853) -> float:
    """Return the largest error of a state in nominal values, against a tight tolerance."""
    names = [state.name for state in dae.states]
    tight = cosim.solvers.Dop853(relative_tolerance=1e-13)
    run, exact = (cosim.simulate(dae, solver=s, outputs=names) for s in (solver, tight))
    return float(np.max(np.abs(run.values - exact.values) / [s.nominal for s in dae.states]))


def calls_of(dae: cosim.Dae, solver: cosim.solvers.Dop853, options: dict[str, object]) -> int:
    """Return the number of function calls of a repeated run."""
    with cProfile.Profile() as profile:
        cosim.simulate(dae, solver=solver, **options)
    return int(pstats.Stats(profile).total_calls)  # type: ignore[attr-defined] # which typeshed lacks


if __name__ == "__main__":
    main()
