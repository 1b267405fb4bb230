"""Savings by `reduce`: sizes and times of right-hand side and run, full and reduced.

Prints the table of docs/reduce.md. Times are medians of interleaved repeats. Compare the
ratios: the times depend on the machine.
"""

import statistics
from time import perf_counter

import casadi as ca
import numpy as np

import cosim
from casadi_models.dae import Dae
from cosim.codegen.casadi_library import cache_key, external
from cosim.integrate.integrator import start_vectors
from cosim.model.reduction import size

CASES = (
    ("crank_shaft/driven", ("T",)),
    ("crank_shaft/driven", ("fx_A", "fy_A")),
    ("crank_shaft/multipliers", ("T",)),
    ("bar_on_frame/reduced", ("theta",)),
    ("bar_on_frame/reduced", ("M_phi",)),
    ("bar_on_frame/reduced", ("f1_A_F", "f2_A_F")),
    ("bar_on_frame/two_body", ("theta",)),
    ("bicycle/independent", ("phi", "delta")),
    ("bicycle/independent", ("xP", "yP")),
    ("bicycle/independent", ("fz_P", "fz_Q")),
    ("bicycle/book", ("phi", "delta")),
    ("bicycle/multipliers", ("phi", "delta")),
    ("disk_two_bars/reduced", ("theta1", "theta2")),
    ("disk_two_bars/multipliers", ("theta1", "theta2")),
    ("double_pendulum/quaternion", ("x_tip", "y_tip", "z_tip")),
    ("double_pendulum/multipliers", ("w1_z",)),
)
REPEATS = 15
CALLS = 20_000


def right_hand_side_time(dae: Dae) -> float:
    """Return the time of one compiled evaluation of equations and outputs, s."""
    symbols = [dae.t, dae.x, dae.z, dae.u, dae.p]
    results = [ca.vertcat(dae.ode, dae.alg, dae.outputs)]
    function = ca.Function("rhs", symbols, results, {"cse": True})
    if not function.numel_out(0):
        return 0.0
    (fast,) = external([function], cache_key("benchmark", function), ["rhs"])
    many = fast.map("many", "serial", CALLS, [0, 1, 2, 3, 4], [])
    start = start_vectors(dae)
    arguments = [0.0, start["x0"], start["z0"], start["u"], start["p"]]
    began = perf_counter()
    many(*arguments)
    return (perf_counter() - began) / CALLS


def run_time(dae: Dae) -> float:
    solver = "rosenbrock" if dae.algebraics else "erk"
    began = perf_counter()
    cosim.simulate(dae, solver=solver, relative_tolerance=1e-8, compiled=True)
    return perf_counter() - began


def main() -> None:
    print(
        "| model | outputs | states | algebraics | parameters | operations | per call | per run |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name, outputs in CASES:
        full = cosim.load(name)
        small = cosim.reduce(full, outputs)
        pair = (full, small)
        for dae in pair:  # compile
            right_hand_side_time(dae), run_time(dae)
        calls, runs = (
            np.array([[measure(dae) for dae in pair] for _ in range(REPEATS)])
            for measure in (right_hand_side_time, run_time)
        )
        sizes = [size(dae) for dae in pair]
        counts = " | ".join(
            f"{getattr(sizes[0], key)} → {getattr(sizes[1], key)}"
            for key in ("states", "algebraics", "parameters", "operations")
        )
        print(
            f"| {name} | {', '.join(outputs)} | {counts} | "
            f"{_ratio(calls, 1e9, 'ns')} | {_ratio(runs, 1e3, 'ms')} |"
        )


def _ratio(times: np.ndarray, factor: float, unit: str) -> str:
    before, after = (statistics.median(column) * factor for column in times.T)
    return f"{before:.3g} → {after:.3g} {unit} ({after / before:.0%})"


if __name__ == "__main__":
    main()
