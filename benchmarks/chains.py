"""Right-hand side of hinged chains by the articulated-body recursion, compared with Pinocchio.

    python benchmarks/chains.py [LINKS ...]

Times are the smallest of many interleaved repeats in one process. `pip install pin` installs
Pinocchio.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import casadi as ca
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from helpers.chains import crossed_chain

from cosim.codegen.casadi_library import cache_key, external

CALLS, TURNS = 20, 2000


def compiled(function: ca.Function, q: np.ndarray, u: np.ndarray) -> tuple[Callable, np.ndarray]:
    """Return a call of a function's machine code, and the array for its result."""
    (machine_code,) = external([function], cache_key("chain", function), ["chain"])
    buffer, call = machine_code.buffer()
    result = np.empty(q.size)
    for i, argument in enumerate((q, u)):
        buffer.set_arg(i, memoryview(argument))
    buffer.set_res(0, memoryview(result))

    def evaluate(held: tuple = (buffer, machine_code, q, u)) -> None:
        call()

    return evaluate, result


def pinocchio(n: int, q: np.ndarray, u: np.ndarray) -> tuple[Callable, Callable]:
    """Return a call of Pinocchio's articulated-body algorithm, and a call that computes little.

    The second measures the cost of a call from Python.
    """
    import pinocchio as pin

    model, parent = pin.Model(), 0
    inertia = pin.Inertia(1.0, np.array([0, 0, -0.5]), np.diag([1 / 12, 1 / 12, 0.01]))
    for i in range(n):
        joint = pin.JointModelRY() if i % 2 else pin.JointModelRX()
        place = pin.SE3(np.eye(3), np.array([0, 0, -1.0 if i else 0.0]))
        parent = model.addJoint(parent, joint, place, f"hinge {i}")
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    model.gravity.linear = np.array([0, 0, -9.81])
    data, torque = model.createData(), np.zeros(n)
    return lambda: pin.aba(model, data, q, u, torque), lambda: pin.computeTotalMass(model)


def least(*calls: Callable) -> list[float]:
    """Return the smallest time of each call over interleaved repeats, s."""
    best = [np.inf] * len(calls)
    for _ in range(TURNS):
        for i, call in enumerate(calls):
            began = perf_counter()
            for _ in range(CALLS):
                call()
            best[i] = min(best[i], (perf_counter() - began) / CALLS)
    return best


def main() -> None:
    """Print a row for each number of links."""
    print("links  derived  operations  here     pinocchio  ratio  difference")
    for n in map(int, sys.argv[1:] or ("4", "8", "16", "32")):
        began = perf_counter()
        function = crossed_chain(n)
        derived = perf_counter() - began
        rng = np.random.default_rng(n)
        q, u = rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
        own, result = compiled(function, q, u)
        aba, nothing = pinocchio(n, q, u)
        here, theirs, call = least(own, aba, nothing)
        own()
        off = np.abs(result - aba()).max() / np.abs(result).max()
        theirs -= call
        print(
            f"{n:5}  {derived:5.2f} s  {function.n_instructions():10}  {here * 1e6:5.2f} us  "
            f"{theirs * 1e6:6.2f} us  {here / theirs:5.2f}  {off:.0e}"
        )


if __name__ == "__main__":
    main()
