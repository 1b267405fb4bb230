"""Compare co-simulation through fmpy with native simulation at several communication steps.

    python benchmarks/communication_steps.py [MODEL...]

The table has every formulation in FMI 2.0 and 3.0: the largest difference of any variable over the
model's whole span, in nominal values, at the relative tolerance of `cosim crosscheck`.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import casadi_models
import cosim

STEPS = (1e-3, 1e-2, 1e-1)  # s
INTERVAL = 0.1  # s, of the compared outputs


def difference(path: Path, run: cosim.Trajectory, step: float, tolerance: float) -> float:
    """Return the largest difference from a native run, in nominal values."""
    fine = cosim.simulate_fmu(
        path,
        interface="CoSimulation",
        stop_time=float(run.time[-1]),
        output_interval=step,
        relative_tolerance=tolerance,
    )
    every = round(INTERVAL / step)
    again = replace(fine, time=fine.time[::every], values=fine.values[::every])
    return float(cosim.compare(run, again).worst.scaled)


def main() -> None:
    columns = "".join(f"{f'FMI {fmi}, {1e3 * h:g} ms':>15}" for fmi in (2, 3) for h in STEPS)
    print(f"{'model':32} {'tolerance':>9}{columns}")
    with tempfile.TemporaryDirectory() as folder:
        for model in sys.argv[1:] or casadi_models.CATALOG:
            dae = cosim.load(model)
            tolerance = dae.experiment.reference_tolerance
            run = cosim.simulate(dae, relative_tolerance=tolerance, output_interval=INTERVAL)
            found = []
            for fmi in (2, 3):
                path = cosim.export_fmu(dae, Path(folder) / f"{dae.name}{fmi}.fmu", fmi=fmi)
                found += [difference(path, run, step, tolerance) for step in STEPS]
            print(f"{model:32} {tolerance:9g}{''.join(f'{d:15.1e}' for d in found)}", flush=True)


if __name__ == "__main__":
    main()
