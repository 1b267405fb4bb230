"""Many variants: 1000 bicycles in SIMD lanes, in loops and in heyoka's batches; cost of sweeps.

Prints the tables of docs/sweeps.md. Times are those of one core; compared times are medians of
interleaved repeats. Compare the ratios: the times depend on the machine.

    python benchmarks/ensembles.py [bicycles] [outputs] [scalar] [events] [memory] [fmu] [kills]
"""

import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter, process_time

import casadi as ca
import numpy as np

import cosim
from cosim.codegen.runge_kutta.lane_library import processor_lanes

RUNS, STOP, REPEATS = 1000, 20.0, 5
ROLLS = np.linspace(0.3, 0.5, RUNS)
SOME = slice(0, RUNS, 20)  # slow methods run 50 of the 1000 variants


def timed(call: Callable[[], object]) -> tuple[float, float, object]:
    """Return CPU time and elapsed time in s, and the result."""
    wall, own = perf_counter(), process_time()
    result = call()
    return process_time() - own, perf_counter() - wall, result


def lanes(tolerance: float, threads: int, **more: object) -> cosim.Ensemble:
    settings = {"output_times": [STOP], "outputs": NAMES} | more
    return cosim.simulate_many(
        BICYCLE, {"phi_dot": ROLLS}, relative_tolerance=tolerance, threads=threads, **settings
    )


def loop(solver: str, tolerance: float) -> np.ndarray:
    """Return the results of repeated calls of CasADi's integrator with compiled equations."""
    function = integrator_of(solver, tolerance)
    start, row = cosim.start_vectors(BICYCLE), NAMES.index("phi_dot")
    found = []
    for roll in ROLLS[SOME]:
        start["x0"][row] = roll
        found.append(np.array(function(x0=start["x0"], p=start["p"], u=start["u"])["xf"])[:, -1])
    return np.array(found)


def simulate_loop(tolerance: float) -> np.ndarray:
    found = [
        cosim.simulate(
            BICYCLE, start_values={"phi_dot": roll}, stop_time=STOP, output_interval=STOP,
            outputs=NAMES, solver="dop853", relative_tolerance=tolerance,
        ).values[-1]
        for roll in ROLLS[SOME]
    ]  # fmt: skip
    return np.array(found)


def heyoka_batches(tolerance: float) -> Callable[[], np.ndarray]:
    """Return a run of heyoka's Taylor method in batches of the size that it recommends."""
    import heyoka as hy

    sys.path.append(str(Path(__file__).parent / "peers"))
    import with_heyoka
    from problem import Problem

    problem = Problem(BICYCLE, ())
    variables, results = with_heyoka._expressions(problem)
    size = hy.recommended_simd_size()
    x0 = np.repeat(problem.start["x0"][:, None], size, axis=1)
    system = list(zip(variables, results, strict=True))
    solver = hy.taylor_adaptive_batch(system, x0, tol=tolerance, compact_mode=True)

    def run() -> np.ndarray:
        rolls, found = ROLLS[: 40 * size], []
        for first in range(0, len(rolls), size):
            solver.set_time(0.0)
            solver.state[:] = x0
            solver.state[NAMES.index("phi_dot")] = rolls[first : first + size]
            solver.propagate_until(STOP)
            found.append(solver.state.T.copy())
        return np.concatenate(found)

    return run


def bicycles() -> None:
    exact = lanes(1e-13, 2).values[:, 0]
    some = exact[SOME]
    cases: list[tuple[str, float, Callable[[], object], Callable[[object], float]]] = []
    for tolerance in (3e-4, 1e-6):
        for threads in (1, 2):
            cases.append(
                (f"cosim, {processor_lanes()} lanes, rtol {tolerance:g}, {threads} thread(s)", 1.0,
                 partial(lanes, tolerance, threads),
                 lambda run: float(np.abs(run.values[:, 0] - exact).max()))
            )  # fmt: skip
    share = RUNS / len(some)
    for solver, tolerance in (("cvodes", 3e-7), ("cvodes", 1e-6), ("cvodes_adams", 1e-6)):
        cases.append(
            (f"loop over CasADi's {solver}, compiled, rtol {tolerance:g}", share,
             partial(loop, solver, tolerance), lambda run: float(np.abs(run - some).max()))
        )  # fmt: skip
    cases.append(
        ("loop over cosim.simulate, dop853, rtol 3e-4", share, partial(simulate_loop, 3e-4),
         lambda run: float(np.abs(run - some).max()))
    )  # fmt: skip
    try:
        for tolerance in (1e-6, 1e-9):
            batch = heyoka_batches(tolerance)
            count = len(batch())
            cases.append(
                (f"heyoka {heyoka_version()}, batches, tol {tolerance:g}", RUNS / count, batch,
                 lambda run, n=count: float(np.abs(run - exact[:n]).max()))
            )  # fmt: skip
    except ImportError:
        print("heyoka is not installed")
    for _, _, call, _ in cases:
        call()  # compiled and loaded
    taken: list[list[tuple[float, float]]] = [[] for _ in cases]
    errors = [0.0] * len(cases)
    for _ in range(REPEATS):
        for i, (_, scale, call, error) in enumerate(cases):
            own, wall, result = timed(call)
            taken[i].append((own * scale, wall * scale))
            errors[i] = error(result)
    base = min(statistics.median(own for own, _ in t) for t in taken)
    print(f"| {RUNS} bicycles, {STOP:g} s, end state | error | core, s | wall, s | core, ratio |")
    print("|---|---|---|---|---|")
    for (name, *_), times, error in zip(cases, taken, errors, strict=True):
        own, wall = (statistics.median(column) for column in zip(*times, strict=True))
        print(f"| {name} | {error:.1e} | {own:.3f} | {wall:.3f} | {own / base:.1f} |")


def outputs() -> None:
    """Print the cost of 2001 output times of two variables."""
    call = partial(lanes, 1e-6, 1, output_times=None, stop_time=STOP, outputs=["phi", "delta"])
    call()
    own = statistics.median(timed(call)[0] for _ in range(REPEATS))
    ends = statistics.median(timed(partial(lanes, 1e-6, 1))[0] for _ in range(REPEATS))
    print(f"2001 times of two outputs: {1e3 * own / RUNS:.3f} ms per run, "
          f"{own / ends:.2f} times the end states alone")  # fmt: skip


def scalar() -> None:
    """Compare the right-hand side in SIMD lanes with the scalar one, including the solver."""

    def lane_run() -> float:
        own, _, run = timed(partial(lanes, 1e-8, 1))
        return own / run.rhs_calls.sum()

    calls = cosim.simulate(
        BICYCLE, solver="dop853", relative_tolerance=1e-8, stop_time=STOP, output_interval=STOP
    ).stats["rhs_calls"]

    def scalar_run() -> float:
        function, start = integrator_of("dop853", 1e-8), cosim.start_vectors(BICYCLE)
        start = {name: start[name] for name in ("x0", "p", "u")}
        own, _, _ = timed(lambda: [function(**start) for _ in range(20)])
        return own / 20 / calls

    lane_run(), scalar_run()
    pairs = [(lane_run(), scalar_run()) for _ in range(REPEATS)]
    ratio = statistics.median(a / b for a, b in pairs)
    print(f"right-hand side and its share of the solver: {1e9 * pairs[0][0]:.0f} ns in lanes, "
          f"{1e9 * pairs[0][1]:.0f} ns scalar; median ratio {ratio:.2f}")  # fmt: skip


def bouncing_ball() -> tuple[cosim.Dae, str, tuple[float, float]]:
    model = cosim.Model("ball", stop_time=2.0)
    h = model.state("h", "m", 1.0, "height")
    v = model.state("v", "m/s", 0.0, "speed")
    e = model.parameter("e", "1", 0.7, "restitution")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -e * v}, name="impact")
    return model.freeze(), "e", (0.65, 0.9)


def relay() -> tuple[cosim.Dae, str, tuple[float, float]]:
    model = cosim.Model("relay", stop_time=5.0)
    x = model.state("x", "m", 1.0, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    k = model.parameter("k", "m/s2", 1.0, "force per mass")
    model.derivative(x, v)
    sides = ca.if_else(x > 0.1, 1.0, ca.if_else(x < -0.1, -1.0, 0.0))
    model.derivative(v, -k * sides - 0.1 * v)
    return model.freeze(), "k", (0.5, 2.0)


def sampled_controller() -> tuple[cosim.Dae, str, tuple[float, float]]:
    model = cosim.Model("sampled", stop_time=5.0)
    x = model.state("x", "m", 1.0, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    k = model.parameter("k", "1/s2", 2.0, "gain")
    force = model.discrete("force", "m/s2", 0.0, "force per mass")
    model.derivative(x, v)
    model.derivative(v, force - x)
    model.every(0.25, {force: -k * x - v})
    return model.freeze(), "k", (0.5, 2.0)


def dry_friction() -> tuple[cosim.Dae, str, tuple[float, float]]:
    model = cosim.Model("stick_slip", stop_time=5.0)
    x = model.state("x", "m", 0.0, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    belt = model.parameter("belt", "m/s", 0.5, "speed of the belt")
    slip = belt - v
    model.derivative(x, v)
    model.derivative(v, -10 * x + ca.sign(slip) * (1 + ca.exp(-4 * slip**2)))
    return model.freeze(), "belt", (0.2, 1.0)


def events() -> None:
    """Print the cost of a run with events and two output times, of 1000 together and alone."""
    print("| runs with events, dop853 | events of a run | simulate_many, ms | one simulate, ms |")
    print("|---|---|---|---|")
    for build in (bouncing_ball, relay, sampled_controller, dry_friction):
        dae, name, ends = build()
        stop = dae.experiment.stop_time
        settings = {"solver": "dop853", "output_times": [stop / 2, stop]}
        column = np.linspace(*ends, RUNS)
        many = partial(cosim.simulate_many, dae, {name: column}, **settings)
        single = partial(cosim.simulate, dae, **settings)
        happened = np.mean([len(run.events) for run in many().with_events.values()])
        together, alone = [], []
        for _ in range(3):
            together.append(1e3 * timed(many)[0] / RUNS)
            times = [
                timed(partial(single, start_values={name: value}))[0] for value in column[SOME]
            ]
            alone.append(1e3 * statistics.mean(times))
        own, loop = statistics.median(together), statistics.median(alone)
        print(f"| {dae.name} | {happened:.1f} | {own:.2f} | {loop:.2f} |")


MEMORY = """
import resource, sys
import numpy as np, cosim
runs = int(sys.argv[1])
found = cosim.sweep(
    "bicycle", {"phi_dot": np.linspace(0.3, 0.5, runs)}, outputs=["phi", "delta"],
    keep=["statistics"], stop_time=2.0, output_interval=0.1, relative_tolerance=1e-5, workers=0,
)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(f"{runs} runs, statistics only: {peak / 1024:.0f} MB, mean phi at the end "
      f"{found.statistics.mean('phi')[-1]:.9g}")
"""


def memory() -> None:
    """Print the peak memory of sweeps that store statistics only."""
    for runs in (1_000, 10_000, 100_000):
        subprocess.run([sys.executable, "-c", MEMORY, str(runs)], check=True)


def fmu() -> None:
    """Compare a sweep of an FMU, one instance per process, with a loop of `simulate_fmu`."""
    with tempfile.TemporaryDirectory() as folder:
        path = cosim.export_fmu(BICYCLE, Path(folder) / "bicycle.fmu")
        rolls = ROLLS[:40]
        settings = {"outputs": ["phi"], "stop_time": 1.0, "output_interval": 0.1}

        def alone() -> None:
            for roll in rolls:
                cosim.simulate_fmu(path, start_values={"phi_dot": roll}, **settings)

        def swept() -> None:
            cosim.sweep(path, {"phi_dot": rolls}, workers=0, **settings)

        alone(), swept()
        ratios = [timed(alone)[0] / timed(swept)[0] for _ in range(3)]
        print(f"a sweep of an FMU is {statistics.median(ratios):.1f} times a loop of simulate_fmu")


SWEEP = """
import sys
import numpy as np, cosim
cosim.sweep(
    "bar_on_frame", {"theta_dot": np.linspace(-3, 3, 1000)}, outputs=["theta"],
    keep=["trajectories", "statistics", "final"], solver="cvodes", stop_time=6.0,
    output_interval=0.05, workers=int(sys.argv[3]), store=sys.argv[1],
    resume=sys.argv[2] == "resume",
)
"""


def kills() -> None:
    """Compare a sweep whose processes are killed with an undisturbed serial one."""
    random = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        undisturbed, killed = Path(folder) / "undisturbed", Path(folder) / "killed"
        subprocess.run([sys.executable, "-c", SWEEP, str(undisturbed), "begin", "0"], check=True)
        left, coordinators, how = 20, 3, "begin"
        first: dict[str, int] = {}
        while True:
            call = [sys.executable, "-c", SWEEP, str(killed), how, "2"]
            process = subprocess.Popen(call)
            share = -(-left // (coordinators + 1))
            while process.poll() is None and share:
                time.sleep(random.uniform(0.3, 0.9))
                for worker in random.permutation(workers_of(process.pid))[:1]:
                    os.kill(int(worker), signal.SIGKILL)
                    left, share = left - 1, share - 1
            if coordinators and process.poll() is None:
                process.kill()
                coordinators -= 1
            code = process.wait()
            for path in killed.glob("status/c/*[0-9]"):
                assert (
                    first.setdefault(path.name, path.stat().st_mtime_ns) == path.stat().st_mtime_ns
                )
            how = "resume" if killed.exists() else "begin"
            if code == 0:
                break
        same = all(
            (killed / name).read_bytes() == (undisturbed / name).read_bytes()
            for name in files_of(undisturbed)
        )
        print(f"{20 - left} workers and {3 - coordinators} coordinators killed: "
              f"{'the same bytes' if same else 'OTHER BYTES'} as the undisturbed sweep, "
              f"no block written twice, {len(first)} blocks")  # fmt: skip


def workers_of(sweep: int) -> list[int]:
    """Return the worker processes of a sweep."""
    import psutil

    found = psutil.Process(sweep).children(recursive=True)
    return [p.pid for p in found if "spawn_main" in " ".join(p.cmdline())]


def files_of(folder: Path) -> list[str]:
    return [str(path.relative_to(folder)) for path in sorted(folder.rglob("*")) if path.is_file()]


def heyoka_version() -> str:
    import heyoka

    return str(heyoka.__version__)


def integrator_of(solver: str, tolerance: float) -> object:
    if (solver, tolerance) not in _INTEGRATORS:
        _INTEGRATORS[solver, tolerance] = cosim.integrator(
            BICYCLE, [0.0, STOP], solver=solver, relative_tolerance=tolerance
        )
    return _INTEGRATORS[solver, tolerance]


_INTEGRATORS: dict[tuple[str, float], object] = {}
BICYCLE = cosim.load("bicycle")
NAMES = [variable.name for variable in BICYCLE.states]

if __name__ == "__main__":
    for part in sys.argv[1:] or [
        "bicycles",
        "outputs",
        "scalar",
        "events",
        "memory",
        "fmu",
        "kills",
    ]:
        globals()[part]()
