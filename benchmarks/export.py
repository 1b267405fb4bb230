"""Print the cost of exports: time with an empty and a filled cache, file sizes, instantiation.

    python benchmarks/export.py [--platform NAME] [MODEL...]

Every export runs in a separate process, imports included, as on the command line. Cold means that
no code of the FMU is in the cache; the bundled compiler's own cache of the C libraries is filled.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from statistics import median
from time import perf_counter

import fmpy

import casadi_models
from cosim.fmi.archive import unpacked

ONE = """import cosim, sys
model, target, fmi, platform, name = sys.argv[1:]
dae = cosim.load(model)
cosim.export_fmu(dae, target, fmi=int(fmi), platforms=(platform,), identifier=name)"""
REPEATS = 200


def timed_export(arguments: list[str], cache: Path) -> tuple[float, float]:
    """Return the elapsed time and the CPU time of one export, s."""
    before, began = getrusage(RUSAGE_CHILDREN), perf_counter()
    command = [sys.executable, "-c", ONE, *arguments]
    subprocess.run(command, check=True, env=os.environ | {"COSIM_CACHE": str(cache)})
    after, wall = getrusage(RUSAGE_CHILDREN), perf_counter() - began
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, used


def instantiation(path: Path) -> float:
    """Return the median time of one instantiation through fmpy, library loaded, in us."""
    with unpacked(path) as folder:
        described = fmpy.read_model_description(str(folder))
        instance = fmpy.instantiate_fmu(str(folder), described, "ModelExchange")
        times = []
        for _ in range(REPEATS):
            began = perf_counter()
            instance.fmi2FreeInstance(instance.component)
            instance.instantiate()
            times.append(perf_counter() - began)
        instance.freeInstance()
    return 1e6 * median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("models", nargs="*", default=casadi_models.CATALOG, metavar="MODEL")
    parser.add_argument("--platform", default="native")
    args = parser.parse_args()
    total = 0.0
    print(f"{'model':32} {'cold, s':>8} {'of CPU':>7} {'warm, s':>8} "
          f"{'FMI 2, kB':>10} {'FMI 3, kB':>10} {'instance, us':>13}")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        target, cache = Path(folder) / "model.fmu", Path(folder) / "cache"
        third = Path(folder) / "model3.fmu"
        stamp = f"m{os.getpid()}"  # an identifier that was never compiled
        if args.platform != "native":  # fill the bundled compiler's own cache
            timed_export([args.models[0], str(target), "3", args.platform, stamp + "_"], cache)
        for model in args.models:
            arguments = [model, str(target), "2", args.platform, stamp]
            cold, used = timed_export(arguments, cache)
            warm, _ = timed_export(arguments, cache)
            timed_export([model, str(third), "3", args.platform, stamp], cache)
            total += warm
            sizes = [path.stat().st_size / 1000 for path in (target, third)]
            print(f"{model:32} {cold:8.2f} {used:7.2f} {warm:8.2f} "
                  f"{sizes[0]:10.0f} {sizes[1]:10.0f} {instantiation(target):13.2f}")  # fmt: skip
    print(f"\nall warm: {total:.1f} s")


if __name__ == "__main__":
    main()
