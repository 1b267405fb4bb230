"""Print the cost of exporting large models: CPU time and memory of Python and the compiler.

    python benchmarks/large_exports.py [ball:16] [heat:1000]

Each model is exported in a separate process with an empty cache.
"""

import os
import resource
import sys
import tempfile
import zipfile
from pathlib import Path
from subprocess import run
from time import process_time

import casadi as ca
import numpy as np
from casadi import SX

import cosim
from casadi_models.dae import Dae, Model
from casadi_models.mechanics import kane


def ball_chain(n: int) -> Dae:
    """Return n slender links on ball joints, absolute quaternions and rates: 7 n states."""
    model = Model("ball_chain", stop_time=0.5)
    q, u, rates = [], [], []
    tip, inertias, loads = SX(3, 1), list[kane.InertialTerm](), list[kane.Load]()
    for i in range(n):
        start = {"w": 0.8, "x": 0.6 * (-1) ** i}
        own = [model.state(f"q{i}_{c}", "1", start.get(c, 0.0), f"link {i}") for c in "wxyz"]
        turn = ca.vertcat(*(model.state(f"w{i}_{c}", "rad/s", 0.1, f"link {i}") for c in "xyz"))
        real, part = own[0], ca.vertcat(*own[1:])
        along = turned(real, part, ca.cross(turn, SX([0, 0, -0.5 / n])))
        inertias += kane.body(SX(1), ca.diag(SX([1, 1, 0.01])) / (12 * n**2), tip + along, turn)[1:]
        inertias.append(kane.InertialTerm(tip + along, tip + along))
        loads.append(kane.Load(tip + along, SX([0, 0, -9.81])))
        tip += 2 * along
        q, u = [*q, *own], [*u, turn]
        rates += [-ca.dot(part, turn) / 2, (real * turn + ca.cross(part, turn)) / 2]
    system = kane.System(
        q=ca.vertcat(*q),
        q_dot=ca.vertcat(*rates),
        free=ca.vertcat(*u),
        inertias=tuple(inertias),
        loads=tuple(loads),
    )
    model.derivative(system.q, system.q_dot)
    model.derivative(system.free, kane.accelerations(system).free)
    return model.freeze()


def turned(real: SX, part: SX, vector: SX) -> SX:
    """Return a vector of a body in the frame at rest, by the body's unit quaternion."""
    across = 2 * ca.cross(part, vector)
    return vector + real * across + ca.cross(part, across)


def heat(n: int) -> Dae:
    """Return the heat equation on n nodes."""
    T, h = ca.MX.sym("T", n), 1 / (n + 1)
    starts = {"T": np.sin(np.pi * h * np.arange(1, n + 1))}
    flow = ca.diff(ca.vertcat(0, T, 0)) / h
    return cosim.from_casadi({"x": T, "ode": ca.diff(flow) / h}, starts, name="heat")


MODELS = {"ball": ball_chain, "heat": heat}


def measure(name: str) -> None:
    """Export a model and print a row."""
    kind, size = name.split(":")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["COSIM_CACHE"] = folder
        began = process_time()
        dae = MODELS[kind](int(size))
        built = process_time() - began
        path = cosim.export_fmu(dae, Path(folder) / "large.fmu")
        with zipfile.ZipFile(path) as archive:
            code = archive.getinfo("sources/equations.c").file_size
    compiler = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{name:10} {len(dae.states):6} {dae.operations():11,} {code / 1e6:5.1f} MB "
        f"{built:5.1f} s {process_time() - began - built:5.1f} s "
        f"{compiler.ru_utime + compiler.ru_stime:6.1f} s {compiler.ru_maxrss / 1e6:6.2f} GB",
        flush=True,
    )


def main() -> None:
    """Print a row for each model."""
    if sys.argv[1:2] == ["--one"]:
        measure(sys.argv[2])
        return
    print("model      states  operations     C     built  export compiler  memory", flush=True)
    for name in sys.argv[1:] or ("ball:16", "heat:1000"):
        run([sys.executable, __file__, "--one", name], check=True)


if __name__ == "__main__":
    main()
