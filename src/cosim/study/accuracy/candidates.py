"""Candidates: error and cost of solvers at many tolerances, measured once for a model.

They are measured natively, with the model's own values and span, and cached under a hash of
equations, values, outputs, solvers, versions and machine.
"""

import json
import os
import platform
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from time import perf_counter

from casadi_models.dae import Dae
from cosim.codegen.cache import content_of, store_if_possible
from cosim.codegen.compiler import find_compiler
from cosim.errors import CosimError, SolverError
from cosim.integrate.outputs import all_columns
from cosim.integrate.run import run
from cosim.integrate.solvers import requested_solver
from cosim.memo import digest_of
from cosim.model.request import Policy, RunRequest
from cosim.model.times import Times
from cosim.study.pareto import pareto_front
from cosim.verify.comparison import compare
from cosim.verify.reference import Reference, reference, reference_key, rounding_errors

TOLERANCES = (*(float(f"1e-{i}") for i in range(2, 14)), 3e-14)
ROUNDS = 4  # timed runs, of which the fastest counts: other work of the machine only adds time
TIMING_SECONDS = 5.0  # after this time no configuration is timed again
MOST_CALLS = 200_000  # of the equations; a solver that needs more is not run at tighter tolerances
# Time of a call in those of the equations, and beside them, s: the choice must not follow the noise
# of measured times, so that a command gives the same bits again
_TYPICAL = {"cvodes": (1, 2.5e-6), "idas": (1, 2.5e-6), "rosenbrock": (3, 1e-7)}
_OTHERS, _OPERATION = (1, 5e-8), 2.5e-10
_IMPLICIT = "rosenbrock"
_FORMAT = "candidates-4"


@dataclass(frozen=True)
class Candidate:
    """Measured error and time of a solver at a tolerance.

    Attributes:
        solver: Name of the solver.
        tolerance: Relative tolerance.
        errors: Largest global error of each variable, in nominal values.
        solve_time: Time of the solver, s.
        rhs_calls: Number of evaluations of the equations.
        work: Typical time for so many, s.
    """

    solver: str
    tolerance: float
    errors: Mapping[str, float]
    solve_time: float
    rhs_calls: int
    work: float

    @property
    def error(self) -> float:
        """The largest error."""
        return max(self.errors.values())

    def __str__(self) -> str:
        return f"{self.solver} at {self.tolerance:g}"


@dataclass(frozen=True)
class Candidates:
    """All candidates of a model.

    Attributes:
        every: The fastest run of each solver at each tolerance.
        rounding: Rounding error of double precision in each variable, in nominal values.
    """

    every: tuple[Candidate, ...]
    rounding: Mapping[str, float]

    def cheapest_first(
        self, names: Sequence[str], *, without: Collection[str] = ()
    ) -> tuple[Candidate, ...]:
        """Return the Pareto front for work and error of some variables, the cheapest first."""
        compared = [
            replace(candidate, errors={name: candidate.errors[name] for name in names})
            for candidate in self.every
            if candidate.solver not in without
        ]
        return pareto_front(compared, lambda c: c.work, lambda c: c.error)


def candidates_of(request: RunRequest, *, compiled: bool, stiff: bool = False) -> Candidates:
    """Return the candidates of the model of a request; see `measured_candidates`.

    If the run with the model's own values and span fails, they are those of the request's, from
    time 0 on.
    """
    dae = request.dae
    try:
        return measured_candidates(dae, compiled=compiled, stiff=stiff)
    except SolverError:
        own = replace(request, times=Times(*request.times.span(dae))).configured()
        if own.digest == dae.digest:
            raise
        return measured_candidates(own, compiled=compiled, stiff=stiff)


def measured_candidates(dae: Dae, *, compiled: bool, stiff: bool = False) -> Candidates:
    """Return the candidates of a model with its own values and span, cached if possible.

    Args:
        dae: The model.
        compiled: Whether its equations are compiled.
        stiff: Whether a second implicit solver is measured although explicit ones do for that span.
    """
    every = tuple(column.name for column in all_columns(dae))
    request = RunRequest(dae, outputs=every, policy=Policy(compiled=compiled))
    entry = f"candidates/{_key(request, compiled)}{'-stiff' if stiff else ''}"
    return _read(entry) or _measured(request, compiled, entry, stiff=stiff)


def solvers(dae: Dae, *, compiled: bool) -> tuple[str, ...]:
    """Return the measured solvers, of different kinds, so that one can check another."""
    own = ("idas", "rosenbrock") if dae.algebraics else ("cvodes", "erk")
    return (*own, "dop853") if compiled else own


def _key(request: RunRequest, compiled: bool) -> str:
    compiler = " ".join(find_compiler()) if compiled else "interpreted"
    machine = (platform.node(), platform.machine(), os.cpu_count())
    names = solvers(request.dae, compiled=compiled)
    facts = (_FORMAT, version("cosim-rigid"), names, TOLERANCES)
    text = repr((reference_key(request), request.dae.full_name, facts, compiler, machine))
    return digest_of((text.encode(),))[:32]


def _measured(request: RunRequest, compiled: bool, entry: str, *, stiff: bool) -> Candidates:
    best = reference(request)
    names = solvers(request.dae, compiled=compiled)
    every = [_of_solver(request, name, best) for name in names]
    found = [one for own in every for one in own]
    stiff |= not all(every) or any(one.rhs_calls > MOST_CALLS for one in found)
    if _IMPLICIT not in names and stiff:
        found += _of_solver(request, _IMPLICIT, best)  # explicit ones cannot check the other one
    began = perf_counter()
    for _ in range(ROUNDS - 1):
        for i, candidate in enumerate(found):
            if perf_counter() - began < TIMING_SECONDS:
                again = _run(request, candidate.solver, candidate.tolerance, best) or candidate
                found[i] = min(candidate, again, key=lambda c: c.solve_time)
    candidates = Candidates(tuple(found), rounding_errors(best.run))
    content = json.dumps(asdict(candidates)).encode()
    store_if_possible(entry, content)  # else they are measured again next time
    return candidates


def _of_solver(request: RunRequest, name: str, best: Reference) -> list[Candidate]:
    """Return the runs of a solver, the loosest first, up to a tolerance that is too tight."""
    found: list[Candidate] = []
    for tolerance in TOLERANCES:
        candidate = _run(request, name, tolerance, best)
        if candidate is not None:
            found.append(candidate)
        if found and (candidate is None or candidate.rhs_calls > MOST_CALLS):
            break  # the first ones may be too loose
    return found


def _run(request: RunRequest, solver: str, tolerance: float, best: Reference) -> Candidate | None:
    """Return cost and errors of a run, errors at least the reference's; None if it fails."""
    request = replace(request, solver=requested_solver(request.dae, solver, tolerance))
    try:
        found = run(request)
    except CosimError:
        return None
    outputs = best.run.select(request.outputs or ())
    differences = compare(outputs, found, by_nominal=True).differences
    errors = {d.name: max(d.scaled, best.errors[d.name]) for d in differences}
    calls = int(found.stats.get("rhs_calls", 0))
    share, more = _TYPICAL.get(solver, _OTHERS)
    work = calls * (share * _OPERATION * request.dae.operations() + more)
    return Candidate(solver, tolerance, errors, found.stats.get("solve_time", 0.0), calls, work)


def _read(entry: str) -> Candidates | None:
    content = content_of(entry)
    if content is None:
        return None
    try:
        facts = json.loads(content)
        every = tuple(Candidate(**candidate) for candidate in facts["every"])
        return Candidates(every, facts["rounding"])
    except (ValueError, KeyError, TypeError):
        return None  # of another version
