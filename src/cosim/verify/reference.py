"""`reference`: the trajectory that the errors of all other runs are measured against.

Different methods run at their tightest. The two that agree best are used; their difference is the
estimate of the reference's own error, variable by variable. The reference is computed for the
numbers of one request, and cached.
"""

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from cosim.codegen.cache import content_of, store_if_possible
from cosim.codegen.compiler import has_compiler
from cosim.errors import ParameterError, SolverError, UsageError
from cosim.integrate.families.casadi_rk import Erk, Rosenbrock
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.families.fixed_step import FixedStep, Ode8
from cosim.integrate.families.sundials import Idas
from cosim.integrate.outputs import all_columns
from cosim.integrate.run import run as execute
from cosim.memo import digest_of
from cosim.model.request import Policy, RunRequest
from cosim.model.solver import AdaptiveSolver, Solver
from cosim.model.times import Times, time_grid
from cosim.scene.scene import Scene
from cosim.trajectory import Trajectory
from cosim.verify.comparison import compare

ENOUGH = 3e-12  # estimated error, in nominal values, at which no further method is tried
_REFERENCE_FORMAT = "reference-6"


# In the order of trial; which of them succeed depends on the model. The number is a relative
# tolerance; for a fixed-step method, it is the number of steps per output interval.
METHODS: tuple[tuple[type[Solver], float], ...] = (
    (Dop853, 3e-14),
    (Erk, 3e-14),
    (Ode8, 2),
    (Ode8, 8),
    (Rosenbrock, 1e-13),
    (Rosenbrock, 1e-12),
    (Idas, 1e-12),
    (Idas, 1e-11),
)


@dataclass(frozen=True)
class Reference:
    """A trajectory with an estimate of its own error.

    Attributes:
        run: Every state, algebraic unknown and output of the full model.
        method: The method that computed it.
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

    def __repr__(self) -> str:
        return f"{self.run.model}: {self.method}, {self.error():.1e} from {self.check}"


def reference(subject: Scene | RunRequest | Dae) -> Reference:
    """Return the reference of a scene, a request, or a model with its own numbers.

    It is cached under a hash of everything that it depends on.

    Raises:
        SolverError: No two methods reach the stop time.
        CosimError: The start values contradict the constraints; see `simulate`.

    Example:
        >>> import cosim
        >>> found = reference(cosim.load("crank_shaft"))
        >>> found.error(["phi"]) < 1e-8
        True
    """
    if isinstance(subject, Dae):
        subject = RunRequest(subject)
    if isinstance(subject, Scene):
        subject = subject.request
    UsageError.reject("reference", subject, RunRequest, "a Scene or a Dae")
    key = reference_key(subject)
    entry = f"references/{key}"
    known = _read_reference(entry, key)
    if known is not None:
        return known
    found = _computed(subject, key)
    content = io.BytesIO()
    stats = {name: getattr(found, name) for name in ("method", "check", "errors", "key")}
    replace(found.run, stats=stats).to_npz(content)
    store_if_possible(entry, content.getvalue())  # else it is computed again next time
    return found


def reference_key(request: RunRequest) -> str:
    """Return a hash of everything that the trajectory of a request depends on."""
    dae = request.configured()
    start, stop = request.times.span(dae)
    grid = time_grid(start, stop, dae.experiment.output_interval)
    methods = [(solver.name, setting) for solver, setting in METHODS]
    inputs = request.inputs and request.inputs.digest
    facts = repr((_REFERENCE_FORMAT, ca.CasadiMeta.version(), dae.digest, inputs, methods))
    return digest_of((facts.encode(), grid.tobytes()))[:32]


def _computed(request: RunRequest, key: str) -> Reference:
    dae = request.configured()
    everything = replace(
        request,
        dae=dae,
        values={},
        times=Times(*request.times.span(dae)),
        outputs=tuple(column.name for column in all_columns(dae)),
        policy=Policy(),
    )
    runs: list[tuple[Solver, str, Trajectory]] = []
    reasons: list[str] = []
    best: Reference | None = None
    for solver, label in _methods_for(dae):
        if solver.uses_jacobian and best is not None and best.error() <= ENOUGH:
            break
        try:
            runs.append((solver, label, execute(replace(everything, solver=solver))))
        except (SolverError, ParameterError) as error:  # a step size may make too many steps
            reasons.append(str(error))
            continue
        best = _best_pair(runs, key)
    if best is None:
        why = f"; {reasons[0]}" if reasons else ""
        raise SolverError(f"{dae.full_name}: no two methods agree on a reference{why}")
    return best


def _methods_for(dae: Dae) -> Iterator[tuple[Solver, str]]:
    """Yield the solvers that a model can have, each with its numbers and its name in reports."""
    for kind, setting in METHODS:
        possible = kind.solves_dae or not dae.algebraics
        if not possible or (kind.compiled_only and not has_compiler()):
            continue
        if issubclass(kind, FixedStep):
            step = dae.experiment.output_interval / setting
            yield kind(step_size=step), f"{kind.name} with {setting:g} steps per output interval"
        elif issubclass(kind, AdaptiveSolver):
            yield kind(relative_tolerance=setting), f"{kind.name} at {setting:g}"


def _best_pair(runs: Sequence[tuple[Solver, str, Trajectory]], key: str) -> Reference | None:
    """Return the pair of different methods that agree best."""
    best: Reference | None = None
    for (solver, label, run), (other, other_label, again) in combinations(runs, 2):
        if solver.name == other.name:
            continue
        least = rounding_errors(run)
        differences = compare(run, again, by_nominal=True).differences
        apart = {d.name: max(d.scaled, least[d.name]) for d in differences}
        found = Reference(run, label, other_label, apart, key)
        if best is None or found.error() < best.error():
            best = found
    return best


def rounding_errors(run: Trajectory) -> dict[str, float]:
    """Return the rounding error of double precision in each variable, in nominal values."""
    return {c.name: float(np.spacing(np.abs(run[c.name]).max())) / c.nominal for c in run.columns}


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
