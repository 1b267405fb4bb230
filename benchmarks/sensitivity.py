"""Derivatives of the bicycle's final state by its 26 parameters: time over that of one run.

    python benchmarks/sensitivity.py [SECONDS_OF_MOTION]

Prints CPU times of all threads together, relative to one `dop853` run of the same span and
tolerance; each is the smallest of several interleaved rounds. The methods are `cosim.sensitivity`
(variational equations in SIMD lanes), without and with its check; central differences of `dop853`
runs in lanes; CasADi's forward mode through CVODES; and heyoka's variational equations at the
loosest tolerance whose error is no larger than that of `cosim.sensitivity`.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from time import process_time

import casadi as ca
import numpy as np

import cosim
from casadi_models.dae import Dae
from cosim.api import simulate
from cosim.study.sensitivity.sensitivity import sensitivity

ROUNDS = 7
STEP = 1e-4
HEYOKA_TOLERANCES = (1e-6, 5e-7, 2e-7, 1e-7)  # half a minute to compile each


def main(span: float) -> None:
    """Print the ratios and how far each method is from a run at a tight tolerance."""
    dae = cosim.load("bicycle/independent")
    tolerance = {"relative_tolerance": 1e-6}
    times = {"stop_time": span, "output_interval": span}
    names = [v.name for v in dae.parameters]
    states = [v.name for v in dae.states]
    sizes = np.array([abs(v.start or 0.0) or v.nominal for v in dae.parameters])

    def central() -> np.ndarray:
        values = {v.name: np.full(2 * len(names), v.start) for v in dae.parameters}
        for i, name in enumerate(names):
            values[name][2 * i] += STEP * sizes[i]
            values[name][2 * i + 1] -= STEP * sizes[i]
        numbers = {"outputs": states, "relative_tolerance": 1e-9, **times}
        last = cosim.simulate_many(dae, values, **numbers).values
        return ((last[::2, -1] - last[1::2, -1]) / (2 * STEP)).T

    start = cosim.start_vectors(dae)
    x, p = ca.MX.sym("x", dae.x.numel()), ca.MX.sym("p", dae.p.numel())
    F = cosim.integrator(dae, [0.0, span], solver="cvodes", compiled=False, **tolerance)
    end = F(x0=x, z0=start["z0"], p=p, u=start["u"])["xf"][:, -1]
    seeds = ca.DM(np.diag(sizes))
    directions = ca.Function("d", [x, p], [ca.jtimes(end, p, seeds)])
    before = ca.Function("x0", [p], [start_of(dae, p)])
    slopes = np.array(ca.Function("s", [p], [ca.jacobian(before(p), p)])(start["p"]))
    by_start = ca.Function("b", [x, p], [ca.jtimes(end, x, ca.DM(slopes * sizes))])

    def casadi_forward() -> np.ndarray:
        arguments = (start["x0"], start["p"])
        return np.array(directions(*arguments)) + np.array(by_start(*arguments))

    def ours(check: bool) -> np.ndarray:
        found = sensitivity(dae, outputs=states, check=check, **times, **tolerance)
        return found.values[-1] * sizes

    methods: dict[str, Callable[[], object]] = {
        "one run": lambda: simulate(dae, solver="dop853", outputs=states, **times, **tolerance),
        "sensitivity": lambda: ours(check=False),
        "sensitivity, checked": lambda: ours(check=True),
        "central differences": central,
        "CasADi forward CVODES": casadi_forward,
    }
    truth = sensitivity(dae, outputs=states, check=False, **times, relative_tolerance=1e-12)
    exact = truth.values[-1] * sizes

    def error(found: np.ndarray) -> float:
        return float((np.abs(found - exact) / (np.abs(exact) + 1)).max())

    aim = error(ours(check=False))
    peers = heyoka_runs(dae, start, slopes, span)
    scaled = ((name, lambda run=run: run() * sizes) for name, run in peers)
    methods.update(next(([pair] for pair in scaled if error(pair[1]()) <= aim), []))
    best = dict.fromkeys(methods, float("inf"))
    results = {name: method() for name, method in methods.items()}  # compiled, and warm
    for _ in range(ROUNDS):
        for name, method in methods.items():
            began = process_time()
            method()
            best[name] = min(best[name], process_time() - began)
    print(f"{'':24}{'ratio':>8}{'error':>10}   (26 parameters, {span:g} s of motion)")
    for name in methods:
        apart = "" if name == "one run" else f"{error(results[name]):10.1e}"
        print(f"{name:24}{best[name] / best['one run']:8.1f}{apart}")


def start_of(dae: Dae, p: ca.MX) -> ca.MX:
    """Return the start of every state as an expression of the parameters."""
    from cosim.codegen.initialization import start_function

    u = ca.DM([v.start or 0.0 for v in dae.inputs])
    return start_function(dae)(0.0, ca.DM(list(dae.x_start)), u, p)[0]


def heyoka_runs(
    dae: Dae, start: Mapping[str, ca.DM], slopes: np.ndarray, span: float
) -> Iterator[tuple[str, Callable[[], np.ndarray]]]:
    """Yield heyoka's runs by name, one for each tolerance, the loosest first."""
    sys.path.append(str(Path(__file__).parent / "peers"))
    try:
        import with_heyoka
    except ImportError as missing:
        print(f"heyoka is not measured: {missing}; pip install 'cosim-rigid[benchmarks]'")
        return
    x0, p = (np.array(start[name]).ravel() for name in ("x0", "p"))
    prepare = with_heyoka.final_derivatives(dae, x0, p, slopes, span)
    for tolerance in HEYOKA_TOLERANCES:
        yield f"heyoka, {tolerance:g}", prepare(tolerance)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
