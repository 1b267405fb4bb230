"""Coupled systems: error and cost of co-simulation by each method, against all parts as one model.

    python benchmarks/coupling.py

Prints, for the systems of examples/coupled, the true error and the estimate for each accuracy,
macro steps, and processor time in units of that of the one model under dop853 (least of several);
then `cosim tradeoff` of each: error and order of each method by macro step; then libcosim, which
holds inputs, if libcosimpy is installed.
"""

from pathlib import Path
from time import process_time

import numpy as np

import cosim
from cosim.coupling.files import read_system
from cosim.errors import SolverError
from cosim.study.tradeoff.configuration import Selection

FOLDER = Path(__file__).parents[1] / "examples" / "coupled"
NAMES = [
    *("ride", "quarter_car", "dual_mass", "three_masses", "cut_pendulum", "driven_frame", "loop"),
    *("strong_loop", "digital_ride"),
]
REPEATS = 9


def error_of(run, exact):
    """Return the largest difference of outputs, in nominal values."""
    sizes = {column.name: column.nominal for column in run.columns}
    found = (np.abs(run[n] - exact[n]).max() / sizes[n] for n in run.names if n in exact.names)
    return float(max(found))


def exact_run(system, **times):
    return cosim.simulate(system.dae, solver="dop853", relative_tolerance=1e-12, **times)


def accuracies() -> None:
    print("system         asked    error   estimate  steps  all steps  time/one model")
    for name in NAMES:
        system = read_system(FOLDER / f"{name}.toml")
        exact = exact_run(system)
        for accuracy in (1e-3, 1e-6, 1e-8):
            whole, parts = [], []
            try:
                for _ in range(REPEATS):
                    began = process_time()
                    cosim.simulate(system.dae, solver="dop853", relative_tolerance=accuracy)
                    whole.append(process_time() - began)
                    began = process_time()
                    run = system.simulate(accuracy=accuracy)
                    parts.append(process_time() - began)
            except SolverError as error:
                print(f"{name:14} {accuracy:7.0e} {error}")
                continue
            ratio = min(parts) / min(whole)
            stats = run.stats
            print(
                f"{name:14} {accuracy:7.0e} {error_of(run, exact):8.1e} "
                f"{stats['error_estimate']:9.1e} {stats['macro_steps']:6} "
                f"{stats['all_macro_steps']:10} {ratio:10.1f}"
            )


def orders() -> None:
    chosen = Selection(steps=(0.04, 0.02, 0.01, 0.005))
    for name in NAMES:
        system = read_system(FOLDER / f"{name}.toml")
        print(f"\n{cosim.tradeoff(system, selection=chosen, repeats=0)}")


def drift() -> None:
    """Print the drift of the energy of the undamped dual-mass oscillator over 1000 periods."""
    system = read_system(FOLDER / "dual_mass.toml")
    period = 2 * np.pi / np.sqrt(10.0)
    ways = {"stop_time": 1000 * period, "output_interval": 10 * period}
    run = system.simulate(**ways, macro_step=0.02)
    energy = run["a.energy"] + run["b.energy"]
    print(f"\nenergy of dual_mass after 1000 periods at 20 ms: {energy[-1] / energy[0] - 1:.1e}")


def libcosim() -> None:
    """Print the error of the ride in libcosim, and the steps that it would need for ours."""
    try:
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
        from libcosimpy.CosimObserver import CosimObserver
        from libcosimpy.CosimSlave import CosimLocalSlave
    except ImportError as error:
        print(f"\nlibcosim is left out: {error}")
        return
    log_output_level(CosimLogLevel.ERROR)
    system = read_system(FOLDER / "ride.toml")
    exact = exact_run(system)
    states = {"phi": exact["bicycle.phi"][-1], "delta": exact["bicycle.delta"][-1]}
    parts = system._co_simulation.parts
    step, errors = 1e-3, []
    for length in (2 * step, step):
        execution = CosimExecution.from_step_size(step_size=round(length * 1e9))
        slaves = {n: execution.add_local_slave(CosimLocalSlave(str(p.path), n))
                  for n, p in parts.items()}  # fmt: skip
        references = {
            n: {v.name: v.valueReference for v in p.description.modelVariables}
            for n, p in parts.items()
        }
        for part, values in system._of_parts(system.start_values).items():
            for name, value in values.items():
                execution.real_initial_value(slaves[part], references[part][name], value)
        for wire in system.connections:
            (sink, entry), (source, output) = wire.input, wire.output
            execution.connect_real_variables(
                slaves[source], references[source][output], slaves[sink], references[sink][entry]
            )
        observer = CosimObserver.create_last_value()
        execution.add_observer(observer=observer)
        execution.simulate_until(target_time=2_000_000_000)
        found = observer.last_real_values(
            slaves["bicycle"], [references["bicycle"][name] for name in states]
        )
        errors.append(max(abs(a - b) for a, b in zip(found, states.values(), strict=True)))
    run = system.simulate(accuracy=1e-6)
    own = max(abs(run[f"bicycle.{n}"][-1] - value) for n, value in states.items())
    needed = 2 / step * errors[1] / own
    steps = max(run.stats["part_steps"].values())
    print(f"\nride: libcosim {errors[0]:.1e}, {errors[1]:.1e} at 2 and 1 ms; here {own:.1e} with "
          f"{steps} steps of a part, for which it needs {needed:.0f}")  # fmt: skip


if __name__ == "__main__":
    accuracies()
    orders()
    drift()
    libcosim()
