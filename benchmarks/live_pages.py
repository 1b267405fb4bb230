"""Pages that compute: time of a run in node, size, and difference from the native FMU.

    python benchmarks/live_pages.py

Needs node, and the packages of cosim-rigid[live]. The difference is the largest of the default run,
relative to the largest or the nominal value of each variable.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import casadi_models
import cosim

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from helpers.live_pages import computed


def main() -> None:
    print(f"{'formulation':32}{'difference':>12}{'run [ms]':>10}{'page [MB]':>11}")
    for name in casadi_models.CATALOG:
        dae = cosim.load(name)
        with tempfile.TemporaryDirectory() as folder:
            found = computed(dae, {}, Path(folder))
            fmu = cosim.export_fmu(dae, Path(folder, "x.fmu"))
            run = cosim.simulate_fmu(fmu, interface="CoSimulation", outputs=found["names"])
        worst = 0.0
        for variable, values in zip(found["names"], found["values"], strict=True):
            size = max(np.abs(run[variable]).max(), run.column(variable).nominal)
            worst = max(worst, float(np.abs(values - run[variable]).max() / size))
        megabytes = found["bytes"] / 1e6
        print(f"{name:32}{worst:12.1e}{found['milliseconds']:10.1f}{megabytes:11.2f}")


if __name__ == "__main__":
    main()
