"""The bicycle over 20 s: compiled solvers against interpreted CVODES, all at rtol 1e-8.

Prints medians of the solver's own time over interleaved repeats, then times of the command line.
"""

import statistics
import subprocess
import sys
from time import perf_counter

import cosim

CASES = {
    "cvodes interpreted": {"solver": "cvodes", "compiled": False},
    "cvodes compiled": {"solver": "cvodes", "compiled": True},
    "erk interpreted": {"solver": "erk", "compiled": False},
    "erk compiled": {"solver": "erk", "compiled": True},
    "dop853 compiled": {"solver": "dop853", "compiled": True},
}
REPEATS = 21


def main() -> None:
    dae = cosim.load("bicycle")
    times: dict[str, list[float]] = {name: [] for name in CASES}
    for repeat in range(REPEATS + 1):
        for name, options in CASES.items():
            run = cosim.simulate(dae, relative_tolerance=1e-8, **options)
            if repeat:  # the first one compiles
                times[name].append(run.stats["solve_time"])
    base = statistics.median(times["cvodes interpreted"])
    for name, values in times.items():
        median = statistics.median(values)
        print(f"{name:20} {median * 1e3:7.2f} ms, {base / median:5.1f} times as fast")
    for words in (["--help"], ["simulate", "bicycle", "--outputs", "phi"]):
        command = [sys.executable, "-m", "cosim", *words]
        seconds = []
        for _ in range(5):
            began = perf_counter()
            subprocess.run(command, capture_output=True, check=True)
            seconds.append(perf_counter() - began)
        print(f"cosim {' '.join(words)}: {statistics.median(seconds):.2f} s")


if __name__ == "__main__":
    main()
