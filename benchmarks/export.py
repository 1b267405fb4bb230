"""Print what an export costs: time from a cold and a warm cache, file sizes, instantiation.

    python benchmarks/export.py [MODEL...]

Every export runs in a process of its own, imports included, as on the command line.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

import fmpy

import casadi_models
from cosim.archive import unpacked

ONE = "import cosim, sys; cosim.export_fmu(cosim.load(sys.argv[1]), sys.argv[2])"
REPEATS = 200


def timed_export(model: str, target: Path, cache: Path) -> float:
    """Return the seconds that one export takes."""
    began = perf_counter()
    command = [sys.executable, "-c", ONE, model, str(target)]
    subprocess.run(command, check=True, env=os.environ | {"COSIM_CACHE": str(cache)})
    return perf_counter() - began


def instantiation(path: Path) -> float:
    """Return the median time of one instantiation through fmpy, library loaded, in ms."""
    with unpacked(path) as folder:
        described = fmpy.read_model_description(str(folder))
        kept = fmpy.instantiate_fmu(str(folder), described, "ModelExchange")
        times = []
        for _ in range(REPEATS):
            began = perf_counter()
            kept.fmi2FreeInstance(kept.component)
            kept.instantiate()
            times.append(perf_counter() - began)
        kept.freeInstance()
    return 1e3 * median(times)


def main() -> None:
    models = sys.argv[1:] or casadi_models.CATALOG
    total = 0.0
    print(f"{'model':32} {'cold, s':>8} {'warm, s':>8} {'file, kB':>9} {'instance, ms':>13}")
    with tempfile.TemporaryDirectory() as folder:
        target, cache = Path(folder) / "model.fmu", Path(folder) / "cache"
        for model in models:
            cold, warm = (timed_export(model, target, cache) for _ in range(2))
            total += warm
            size = target.stat().st_size / 1000
            print(f"{model:32} {cold:8.2f} {warm:8.2f} {size:9.0f} {instantiation(target):13.3f}")
    print(f"\nall warm: {total:.1f} s")


if __name__ == "__main__":
    main()
