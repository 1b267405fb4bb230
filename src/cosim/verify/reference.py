"""The reference of a scene: what the errors of all other runs are measured against.

Different methods run at their tightest. The two that agree best are taken; how far they are apart
is the estimate of the reference's own error, variable by variable. Nothing is known beforehand:
the reference is computed for the numbers of this very scene, and kept in the cache.
"""

import hashlib
import io
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from cosim.codegen.cache import content_of, keep
from cosim.codegen.compiler import has_compiler
from cosim.codegen.initialization import start_function
from cosim.errors import CacheError, SolverError, UsageError
from cosim.integrate.run.outputs import all_columns
from cosim.integrate.simulate import simulate
from cosim.integrate.solvers import SOLVERS
from cosim.model.time_grid import time_grid
from cosim.model.values import assign
from cosim.scene.scene import Scene
from cosim.trajectory import Trajectory
from cosim.verify.comparison import compare

ENOUGH = 3e-12  # estimated error, in nominal values, at which no costly method is tried
_REFERENCE_FORMAT = "reference-3"


@dataclass(frozen=True)
class Way:
    """A solver as accurate as it gets.

    Attributes:
        solver: A name of `SOLVERS`.
        tolerance: Relative, of an adaptive solver.
        parts: How many steps of a fixed-step solver make an output interval.
    """

    solver: str
    tolerance: float | None = None
    parts: int | None = None

    def __str__(self) -> str:
        if self.parts is None:
            return f"{self.solver} at {self.tolerance:g}"
        return f"{self.solver} with {self.parts} steps per output interval"

    def run(self, scene: Scene, dae: Dae) -> Trajectory:
        """Run a DAE with the scene's span and inputs; record all, whatever is observed."""
        settings = scene.settings
        options: dict[str, Any] = {"relative_tolerance": self.tolerance}
        if self.parts is not None:
            options = {"step_size": dae.experiment.output_interval / self.parts}
        return simulate(
            dae,
            start_time=settings.start_time,
            stop_time=settings.stop_time,
            solver=self.solver,
            inputs=scene.inputs,
            outputs=[column.name for column in all_columns(dae)],
            **options,
        )


# In the order of trial. Which of them work depends on the model: stiff, algebraic, chaotic.
WAYS = (
    Way("dop853", 3e-14),
    Way("erk", 3e-14),
    Way("ode8", parts=2),
    Way("ode8", parts=8),
    Way("rosenbrock", 1e-13),
    Way("rosenbrock", 1e-12),
    Way("idas", 1e-12),
    Way("idas", 1e-11),
)


@dataclass(frozen=True)
class Reference:
    """A trajectory with an estimate of its own error.

    Attributes:
        run: Every state, algebraic unknown and output of the full model.
        method: How it was computed.
        check: The second method.
        errors: Largest difference of the two by name, in nominal values.
        key: Hash of equations, values, span and versions.
    """

    run: Trajectory
    method: str
    check: str
    errors: Mapping[str, float]
    key: str

    def error(self, names: Iterable[str] | None = None) -> float:
        """Return the largest estimated error of some variables, or of all."""
        return max(self.errors[name] for name in (self.errors if names is None else names))

    def __str__(self) -> str:
        return f"{self.run.model}: {self.method}, {self.error():.1e} from {self.check}"


def reference(scene: Scene | Dae) -> Reference:
    """Return the reference of a scene, or of a model with its own numbers; from the cache if there.

    Raises:
        SolverError: No two methods reach the stop time.
        CosimError: The start values contradict the constraints; see `simulate`.

    Example:
        >>> import cosim
        >>> found = reference(cosim.load("crank_shaft"))
        >>> found.error(["phi"]) < 1e-8
        True
    """
    if isinstance(scene, Dae):
        scene = Scene(scene.full_name, scene)
    if not isinstance(scene, Scene):
        raise UsageError.of_type("reference", scene, "a Scene or a Dae")
    dae = scene.configured()
    key = reference_key(scene)
    entry = f"references/{key}"
    known = _read_reference(entry, key)
    if known is not None:
        return known
    found = _computed(scene, dae, key)
    _keep_reference(found, entry)
    return found


def reference_key(scene: Scene) -> str:
    """Return a hash of all that a scene's trajectory depends on."""
    dae, settings = scene.configured(), scene.settings
    equations = ca.Function("equations", dae.arguments, [dae.ode, dae.alg, dae.outputs])
    values = assign(dae)
    stop = settings.stop_time
    if stop is None:
        stop = settings.start_time + dae.experiment.stop_time
    grid = time_grid(settings.start_time, stop, dae.experiment.output_interval)
    parts = [equations.serialize().encode(), start_function(dae).serialize().encode()]
    parts += [array.tobytes() for array in (values.x, values.p, values.u, grid)]
    recorded = (*dae.states, *dae.algebraics, *dae.output_variables)
    named = [(v.name, v.nominal) for v in recorded]
    parts.append(repr((_REFERENCE_FORMAT, ca.CasadiMeta.version(), named, WAYS)).encode())
    if scene.inputs is not None:
        parts.append(repr(scene.inputs.names).encode())
        parts += [scene.inputs.time.tobytes(), scene.inputs.values.tobytes()]
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8) + part)
    return digest.hexdigest()[:32]


def _computed(scene: Scene, dae: Dae, key: str) -> Reference:
    runs: dict[Way, Trajectory] = {}
    reasons: list[str] = []
    best: Reference | None = None
    for way in _ways_for(dae):
        if SOLVERS[way.solver].uses_jacobian and best is not None and best.error() <= ENOUGH:
            break
        try:
            runs[way] = way.run(scene, dae)
        except SolverError as error:
            reasons.append(str(error))
            continue
        best = _best_pair(runs, key)
    if best is None:
        told = f"; {reasons[0]}" if reasons else ""
        raise SolverError(f"{dae.full_name}: no two methods agree on a reference{told}")
    return best


def _ways_for(dae: Dae) -> Iterator[Way]:
    for way in WAYS:
        solver = SOLVERS[way.solver]
        possible = solver.solves_dae or not dae.algebraics
        if possible and (has_compiler() or not solver.compiled_only):
            yield way


def _best_pair(runs: Mapping[Way, Trajectory], key: str) -> Reference | None:
    """Return the pair of different methods that agree best."""
    best: Reference | None = None
    for (way, run), (other, again) in combinations(runs.items(), 2):
        if way.solver == other.solver:
            continue
        apart = {d.name: d.scaled for d in compare(run, again).differences}
        # no method carries more digits than the numbers themselves
        for column in run.columns:
            rounding = np.spacing(np.abs(run[column.name]).max()) / column.nominal
            apart[column.name] = max(apart[column.name], float(rounding))
        found = Reference(run, str(way), str(other), apart, key)
        if best is None or found.error() < best.error():
            best = found
    return best


def _keep_reference(found: Reference, entry: str) -> None:
    """Write to the cache; without one, the reference is computed again next time."""
    names = ("method", "check", "errors", "key")
    content = io.BytesIO()
    stats = {name: getattr(found, name) for name in names}
    replace(found.run, stats=stats).to_npz(content)
    with suppress(OSError, CacheError):
        keep(entry, content.getvalue())


def _read_reference(entry: str, key: str) -> Reference | None:
    content = content_of(entry)
    if content is None:
        return None
    try:
        run = Trajectory.from_npz(io.BytesIO(content))
        found = Reference(run=replace(run, stats={"solver": run.stats["method"]}), **run.stats)
    except (UsageError, KeyError, TypeError):
        return None  # of another version
    return found if found.key == key else None
