"""Cost of events: a bouncing ball against scipy, and a relation that never switches.

Prints medians over interleaved repeats: the whole time of `simulate`, that of its solver alone, and
that of `solve_ivp(events=)` for 11 and for 162 impacts at rtol 1e-10, with the largest error of an
impact's time; then the solver's own time of the bicycle with and without a relation in its
equations, for the solvers that look at relations in their compiled loops.
"""

import statistics
from time import perf_counter

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import cosim

REPEATS = 15
G = 9.81
BALLS = ((0.7, 2.5), (0.995, 100.0))  # restitution, stop time


def exact_times(restitution: float, stop: float) -> np.ndarray:
    """Return the times of the impacts in closed form."""
    first = np.sqrt(2 / G)
    later = np.cumsum(2 * first * restitution ** np.arange(1, 500))
    times = first + np.concatenate(([0.0], later))
    return times[times < stop]


def ball(restitution: float = 0.7, stop: float = 2.5):
    model = cosim.Model("ball", stop_time=stop, output_interval=stop / 250)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -G)
    model.when(h < 0, {v: -restitution * v}, name="impact")
    return model.freeze()


def by_scipy(restitution: float, stop: float) -> list[float]:
    def height(_t, y):
        return y[0]

    height.terminal, height.direction = True, -1
    t, y, found = 0.0, [1.0, 0.0], []
    options = {"method": "DOP853", "events": height, "rtol": 1e-10, "atol": 1e-12}
    while True:
        end = solve_ivp(lambda _t, y: [y[1], -G], (t, stop), y, **options)
        if end.status != 1:
            return found
        t, y = end.t[-1], [0.0, -restitution * end.y[1, -1]]
        found.append(t)


def compare_impacts(restitution: float, stop: float) -> None:
    dae, exact = ball(restitution, stop), exact_times(restitution, stop)
    print(f"{len(exact)} impacts")
    times: dict[str, list[float]] = {}
    errors: dict[str, float] = {}

    def note(name: str, time: float, found: list[float]) -> None:
        times.setdefault(name, []).append(time)
        errors[name] = float(np.abs(np.array(found) - exact).max())

    for _ in range(REPEATS + 1):
        began = perf_counter()
        found = by_scipy(restitution, stop)
        note("scipy DOP853", perf_counter() - began, found)
        for solver in ("dop853", "erk", "cvodes"):
            began = perf_counter()
            run = cosim.simulate(dae, solver=solver, relative_tolerance=1e-10)
            note(solver, perf_counter() - began, [event.time for event in run.events])
            note(f"{solver} alone", run.stats["solve_time"], [event.time for event in run.events])
    medians = {name: statistics.median(values[1:]) for name, values in times.items()}
    for name, median in medians.items():  # the first runs compiled
        ratio = medians["scipy DOP853"] / median
        print(f"{name:14} {median * 1e3:7.2f} ms, {ratio:6.2f} times as fast as scipy, "
              f"error {errors[name]:.1e} s")  # fmt: skip


def main() -> None:
    for restitution, stop in BALLS:
        compare_impacts(restitution, stop)

    plain = cosim.load("bicycle")
    far = ca.if_else(plain.x[0] > 1e6, 1.0, 0.0)  # the path is shorter
    related = plain.rewritten(list)
    ode = ca.vertcat(related.ode[:-1], related.ode[-1] + ca.substitute(far, plain.x, related.x))
    related = type(related)(**{**vars(related), "ode": ca.densify(ode)})
    for solver, options in (("dop853", {"relative_tolerance": 1e-8}), ("rk4", {}), ("ode8", {})):
        whole: dict[str, list[float]] = {"smooth": [], "one relation": []}
        inner: dict[str, list[float]] = {"smooth": [], "one relation": []}
        for repeat in range(REPEATS + 1):
            for name, model in zip(whole, (plain, related), strict=True):
                began = perf_counter()
                run = cosim.simulate(model, solver=solver, on_invalid="ignore", **options)
                if repeat:
                    whole[name].append(perf_counter() - began)
                    inner[name].append(run.stats["solve_time"])
        for what, taken in (("whole run", whole), ("solver alone", inner)):
            smooth, one = (statistics.median(values) for values in taken.values())
            print(f"bicycle, {solver}, {what}: {smooth * 1e3:.2f} ms smooth, {one / smooth:.2f} "
                  "times that with a relation that never switches")  # fmt: skip


if __name__ == "__main__":
    main()
