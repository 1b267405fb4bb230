"""Hash the values of runs of every formulation by every solver, to compare two states of the code.

python benchmarks/recorded_runs.py before.json          # in the first state
python benchmarks/recorded_runs.py before.json --check  # in the second state: lists the differences
"""

import argparse
import hashlib
import json
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import casadi_models
import cosim
from cosim.errors import CosimError

ODE = ("cvodes", "cvodes_adams", "erk", "rosenbrock", "rk4", "ode8", "dop853")
DAE = ("idas", "rosenbrock")


def digest(run: cosim.Trajectory) -> str:
    """Return a hash of times, names and values."""
    parts = run.time.tobytes(), repr(run.names).encode(), run.values.tobytes()
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def result(call, *arguments, **options) -> str:
    """Return the hash of a run, or its error."""
    try:
        return digest(call(*arguments, **options))
    except CosimError as error:
        partial = getattr(error, "partial", None)
        return f"{type(error).__name__} {digest(partial) if partial is not None else ''}"


def runs() -> Iterator[tuple[str, str]]:
    """Yield the description of each run, and its hash."""
    for name in casadi_models.CATALOG:
        dae = cosim.load(name)
        span = {"stop_time": min(1.0, dae.experiment.stop_time)}
        yield f"{name} default", result(cosim.simulate, dae, **span)
        for solver in DAE if dae.algebraics else ODE:
            for compiled in (True, False):
                if solver in ("dop853",) and not compiled:
                    continue
                how = "compiled" if compiled else "interpreted"
                options = {"solver": solver, "compiled": compiled, **span}
                yield f"{name} {solver} {how}", result(cosim.simulate, dae, **options)
        if dae.algebraics and dae.invariants:
            options = {"solver": "dop853", "drift_control": "projection", **span}
            yield f"{name} dop853 projection", result(cosim.simulate, dae, **options)
        yield f"{name} 1e-10", result(cosim.simulate, dae, relative_tolerance=1e-10, **span)
        with tempfile.TemporaryDirectory() as folder:
            path = cosim.export_fmu(dae, Path(folder) / "model.fmu")
            for interface in ("ModelExchange", "CoSimulation"):
                yield (
                    f"{name} {interface}",
                    result(cosim.simulate_fmu, path, interface=interface, **span),
                )


def main() -> int:
    """Record, or compare."""
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    found = dict(runs())
    if not arguments.check:
        arguments.file.write_text(json.dumps(found, indent=1))
        print(f"{len(found)} runs")
        return 0
    before = json.loads(arguments.file.read_text())
    apart = {k for k in before.keys() | found.keys() if before.get(k) != found.get(k)}
    for key in sorted(apart):
        print(f"{key}: {before.get(key)} {found.get(key)}")
    print(f"{len(found) - len(apart)} of {len(found)} runs have the same bits")
    return bool(apart)


if __name__ == "__main__":
    raise SystemExit(main())
