"""What `simulate` costs beside its solver: the bicycle, dop853 at an error of 1e-7, 2001 outputs.

All outputs, two states, and two states without a look at the limits. Interleaved repeats on the
processor's clock; the tenth part that was disturbed least; the ratios are what counts.
"""

from time import thread_time

import numpy as np

import cosim

CASES = {
    "all outputs": {},
    "two outputs": {"outputs": ["phi", "delta"]},
    "two outputs, limits ignored": {"outputs": ["phi", "delta"], "on_invalid": "ignore"},
}
REPEATS = 300


def main() -> None:
    dae = cosim.load("bicycle")
    solver = cosim.solvers.Dop853(relative_tolerance=1e-7)
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
              f"{inner * 1e3:.2f} ms")  # fmt: skip


if __name__ == "__main__":
    main()
