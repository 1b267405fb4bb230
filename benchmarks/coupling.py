"""Coupled systems: error and cost of co-simulation by each method, against all parts as one model.

    python benchmarks/coupling.py [--figure FILE.png]

Prints, for the systems of examples/coupled, the true error and the estimate for each accuracy,
macro steps, and the time in units of that of the one model under dop853 (medians, interleaved);
then the error of each method by macro step with its order; then libcosim, which holds inputs, if
libcosimpy is installed. With `--figure FILE` it only draws error against macro step.
"""

import statistics
import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

import cosim
from cosim.colors import CURVES
from cosim.coupling.files import read_system
from cosim.errors import SolverError
from cosim.plotting import STYLE

FOLDER = Path(__file__).parents[1] / "examples" / "coupled"
NAMES = [
    *("ride", "quarter_car", "dual_mass", "three_masses", "cut_pendulum", "driven_frame", "loop"),
    *("strong_loop", "digital_ride"),
]
METHODS = {"jacobi": 1, "gauss_seidel": 1, "extrapolated": 4, "iterated": 4}
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
                    one = cosim.simulate(system.dae, solver="dop853", relative_tolerance=accuracy)
                    run = system.simulate(accuracy=accuracy)
                    whole.append(one.stats["wall_time"])
                    parts.append(run.stats["wall_time"])
            except SolverError as error:
                print(f"{name:14} {accuracy:7.0e} {error}")
                continue
            ratio = statistics.median(parts[1:]) / statistics.median(whole[1:])
            stats = run.stats
            print(
                f"{name:14} {accuracy:7.0e} {error_of(run, exact):8.1e} "
                f"{stats['error_estimate']:9.1e} {stats['macro_steps']:6} "
                f"{stats['all_macro_steps']:10} {ratio:10.1f}"
            )


def by_step(name, steps):
    """Return the errors of a system by method, one for each macro step; outputs at its ends."""
    system = read_system(FOLDER / f"{name}.toml")
    found = {}
    for method in METHODS:
        row = []
        for step in steps:
            exact = exact_run(system, output_interval=step)
            ways = {"macro_step": step, "output_interval": step, "method": method}
            try:
                row.append(error_of(system.simulate(**ways), exact))
            except SolverError:  # unstable: not finite
                row.append(np.nan)
        found[method] = np.array(row)
    return found


def orders() -> None:
    steps = [0.04, 0.02, 0.01, 0.005]
    print(f"\nsystem         method        {'  '.join(f'{s:g} s' for s in steps)}  order")
    for name in NAMES:
        for method, errors in by_step(name, steps).items():
            order = np.log2(errors[-2] / errors[-1])
            shown = "  ".join(f"{e:.1e}" for e in errors)
            print(f"{name:14} {method:12} {shown}  {order:.2f}")


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


def figure(path: str) -> None:
    with matplotlib.rc_context(STYLE):
        _figure(np.geomspace(2e-3, 0.1, 11)).savefig(path, dpi=120)


def _figure(steps: np.ndarray) -> Figure:
    drawing = Figure(figsize=(9, 4.2), layout="constrained")
    axes = drawing.subplots(1, 2, sharey=True)
    titles = {"ride": "Bicycle and rider", "cut_pendulum": "Stiff hinge"}
    for axis, (name, title) in zip(axes, titles.items(), strict=True):
        looks = zip(by_step(name, steps).items(), CURVES, "osD^", strict=False)
        for (method, errors), color, marker in looks:
            shown = np.where(errors < 10, errors, np.nan)
            label = f"{method.replace('_', '-')} (order {METHODS[method]})"
            axis.loglog(steps * 1e3, shown, f"{marker}-", color=color, ms=4, label=label)
        for order, start in ((1, 0.3), (4, 3e-9)):
            slope = start * (steps / steps[0]) ** order
            axis.loglog(steps * 1e3, slope, ":", color="gray", lw=1)
            axis.annotate(
                f"slope {order}",
                (2.1, start * (1.5 if order == 1 else 0.2)),
                color="gray",
                fontsize=8,
            )
        axis.set(title=title, xlabel="macro step [ms]", xlim=(1.8, 110), ylim=(1e-10, 10))
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel("largest error of an output [nominal values]")
    axes[1].annotate("order 1: unstable", (2.2, 3), fontsize=8)
    axes[0].legend(loc="lower right")
    return drawing


if __name__ == "__main__":
    if "--figure" in sys.argv:
        figure(sys.argv[sys.argv.index("--figure") + 1])
    else:
        accuracies()
        orders()
        drift()
        libcosim()
