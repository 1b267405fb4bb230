"""Trade-off study: every configuration is run in turn, within a time limit."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Unpack

from cosim.backend import Backend
from cosim.codegen.compiler import find_compiler, has_compiler
from cosim.coupling.system import System
from cosim.errors import CosimError, UsageError
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.exported import run_file
from cosim.host.temporary import temporary_folder
from cosim.integrate.keywords import Keywords
from cosim.integrate.run import run as execute
from cosim.integrate.solvers import SOLVERS
from cosim.model.catalogue import loaded, observable
from cosim.model.reduction import size
from cosim.model.request import Policy, RunRequest
from cosim.model.values import whole
from cosim.scene.scene import Scene
from cosim.scene.variants import fitting_formulations
from cosim.study.tradeoff.configuration import Configuration, Selection
from cosim.study.tradeoff.coupled import COUPLED, coupled_tradeoff
from cosim.study.tradeoff.fixed_steps import observed_order, stability_limit
from cosim.study.tradeoff.measurement import (
    LEFT_OUT,
    Measurement,
    Outcome,
    combined,
    failed,
    invariants,
    measurement_of,
)
from cosim.study.tradeoff.result import Tradeoff, provenance
from cosim.text import Table
from cosim.trajectory import Trajectory
from cosim.verify.reference import reference

SLOW = 5.0  # s; beyond it, tighter tolerances, smaller steps and interpreted runs are left out
LONG = 0.5  # s; longer runs are timed once
Progress = Callable[[str], None]


def measure(
    selected: Sequence[Configuration],
    run: Callable[[Configuration], Measurement],
    repeats: int,
    deadline: float,
    progress: Progress,
) -> dict[Configuration, list[Measurement]]:
    """Run every configuration, round by round; return the runs of each.

    Of each family, the cheapest configuration comes first. No run begins after the deadline, s, by
    `perf_counter`; `progress` gets a line of text after each first run and after each round.
    """
    measured: dict[Configuration, list[Measurement]] = {each: [] for each in selected}
    for number in range(repeats + 1):
        began = perf_counter()
        for i, (configuration, runs) in enumerate(measured.items(), start=1):
            if number and (not runs[0].errors or runs[0].run_time > LONG):
                continue
            if perf_counter() > deadline:
                if number:
                    progress(f"time limit: {number - 1} of {repeats} repeats are complete")
                    return measured
                left = Outcome(LEFT_OUT, "the time limit was reached; increase seconds")
                runs.append(Measurement(configuration, left))
                continue
            reason = None if number else _too_slow(configuration, measured)
            left = Outcome(LEFT_OUT, reason or "")
            runs.append(Measurement(configuration, left) if reason else run(configuration))
            if number == 0:
                progress(f"{i}/{len(measured)} {_description(runs[0])}")
        progress(f"round {number} of {repeats}: {perf_counter() - began:.0f} s")
    return measured


def _too_slow(
    configuration: Configuration, measured: Mapping[Configuration, Sequence[Measurement]]
) -> str | None:
    """Return which run was too slow that is no slower than this one; None if there is none."""
    for other, runs in measured.items():
        if runs and runs[0].run_time > SLOW and _no_slower(other, configuration):
            return f"{other} took {runs[0].run_time:.1f} s, more than {SLOW:g} s"
    return None


def _no_slower(other: Configuration, configuration: Configuration) -> bool:
    """Return whether another run is coarser, or the compiled one of an interpreted run."""
    pair = (other.backend, configuration.backend) == (Backend.NATIVE, Backend.INTERPRETED)
    similar = replace(other, backend=configuration.backend) if pair else other
    return similar.family == configuration.family and (
        (other.tolerance or 0) >= (configuration.tolerance or 0)
        and (other.step or 0) >= (configuration.step or 0)
    )


def _description(run: Measurement) -> str:
    """Return one line on a run: its error and cost, or why it has no result."""
    if not run.errors:
        return f"{run.configuration}: {run.outcome}"
    calls = "" if run.rhs_calls is None else f", {run.rhs_calls} calls"
    facts = f"error {run.error:.1e} ({run.worst}){calls}, {1e3 * run.run_time:.2f} ms"
    return f"{run.configuration}: {facts}"


REPEATS = 5
SECONDS = 240.0  # after this time of a study, no run begins


def tradeoff(
    subject: Scene | RunRequest | System | str,
    *,
    selection: Selection | None = None,
    every_formulation: bool | None = None,
    repeats: int = REPEATS,
    seconds: float = SECONDS,
    progress: Progress | None = None,
    **ways: Unpack[Keywords],
) -> Tradeoff | Table:
    """Measure error against cost.

    Every configuration runs once for its error and its counts. Then all of them are timed in turn,
    so that other work of the machine affects them equally.

    Args:
        subject: A scene, a request, `MODEL`, `MODEL/FORMULATION` or `PATH.py:FUNCTION`; or a
            coupled system, whose methods of co-simulation are measured over macro steps, those of
            the selection or 10 to 1/8 output intervals, and returned as a table.
        selection: Solvers, tolerances, steps and backends to measure.
        every_formulation: Whether the model's other formulations are measured as well. None: yes,
            unless `subject` names a formulation.
        repeats: Largest number of timed runs of each configuration.
        seconds: Time after which no run begins, s. A configuration that has not run by then is
            listed as left out; one that has run once has the time of that run.
        progress: Called with a line of progress before and after each run.
        ways: Of a coupled system: times, start_values and outputs; see `System.simulate`.

    Raises:
        CosimError: The model cannot be run at all, or there is no reference for it.

    Example:
        >>> from cosim.study.tradeoff.configuration import Selection
        >>> few = Selection(solvers=("erk",), tolerances=(1e-6, 1e-9), backends=("native",))
        >>> study = tradeoff("crank_shaft/driven", selection=few, repeats=1)
        >>> len(study.measurements)
        2
    """
    whole("tradeoff", "repeats", repeats, 0)
    began, progress = perf_counter(), progress or (lambda _: None)
    if isinstance(subject, System):
        steps = selection.steps if selection else ()
        if selection not in (None, Selection(steps=steps)) or not ways.keys() <= {*COUPLED}:
            raise UsageError(f"{subject.name}: give steps, {', '.join(COUPLED)}, and no others")
        return coupled_tradeoff(subject, steps, repeats, began + seconds, progress, **ways)
    if ways:
        raise UsageError(f"tradeoff: {min(ways)} is for coupled systems; put it into a scene")
    if isinstance(subject, str) and every_formulation is None:
        every_formulation = "/" not in subject and ".py:" not in subject
    name, request = _named_request(subject)
    selection = _possible(selection or Selection(), progress)
    if not request.dae.states:
        raise UsageError(f"{name} has no states: there is nothing to integrate")
    request.reject_instant()
    every = every_formulation is not False
    requests = tuple(fitting_formulations(request)) if every else (request,)
    outputs = selected_outputs(requests)
    progress("reference ...")
    truth = reference(request)
    progress(f"reference: {truth}")
    constant = invariants(truth)
    selected = configurations(requests, outputs, selection)
    with temporary_folder() as folder:

        def run(configuration: Configuration) -> Measurement:
            try:
                trajectory = run_configuration(configuration, folder)
            except CosimError as error:
                return failed(configuration, error)
            return measurement_of(configuration, trajectory, truth, outputs, constant)

        measured = measure(selected, run, repeats, began + seconds, progress)
    fixed = _fixed_step_solvers(request, selection)
    limits = [stability_limit(request, truth, solver) for solver in fixed]
    return Tradeoff(
        name,
        outputs,
        constant,
        truth,
        tuple(map(combined, measured.values())),
        tuple(observed_order(request, truth, solver) for solver in fixed),
        tuple(limit for limit in limits if limit is not None),
        _run_facts(request) | provenance(truth),
        _impossible(requests, selection),
    )


def _named_request(subject: object) -> tuple[str, RunRequest]:
    """Return a name and a request without solver and policy, which the study varies."""
    if isinstance(subject, str):
        return subject, RunRequest(loaded(subject))
    name = subject.name if isinstance(subject, Scene) else ""
    request = subject.request if isinstance(subject, Scene) else subject
    if not isinstance(request, RunRequest):
        raise UsageError.of_type("tradeoff", subject, "a Scene, or the name of a model")
    return name or request.dae.full_name, replace(request, solver=None, policy=Policy())


def configurations(
    requests: Sequence[RunRequest], outputs: tuple[str, ...], selection: Selection
) -> tuple[Configuration, ...]:
    """Return the configurations to measure."""
    reducing = requests[0].outputs is not None
    found = tuple(
        configuration
        for request in requests
        for configuration in selection.configurations(
            replace(request, outputs=None), small_request(request, outputs) if reducing else None
        )
    )
    if not found:
        raise UsageError(
            f"{requests[0].dae.full_name}: nothing to measure with solvers "
            f"{', '.join(selection.solvers)} on {', '.join(selection.backends) or 'any backend'}; "
            "an FMU has its own solvers"
        )
    return found


def _run_facts(request: RunRequest) -> dict[str, str]:
    """Return the values that the request sets, and the output times, as text."""
    begin, end = request.times.span(request.dae)
    interval = request.times.interval or request.dae.experiment.output_interval
    unit = {variable.name: variable.unit for variable in request.dae.variables}
    values = ", ".join(f"{n} = {v:.6g} {unit[n]}" for n, v in request.values.items())
    facts = {"values": values} if values else {}
    return facts | {"output times": f"{begin:g} to {end:g} s, every {interval:g} s"}


def _impossible(
    requests: Sequence[RunRequest], selection: Selection
) -> tuple[tuple[str, str], ...]:
    """Return the configurations that cannot be run, each with the reason."""
    found = [pair for request in requests for pair in selection.impossible(request.dae)]
    if not has_compiler():
        compiling = ", ".join(backend for backend in Backend if backend is not Backend.INTERPRETED)
        found.append((compiling, "no C compiler"))
    return tuple(found)


def _fixed_step_solvers(request: RunRequest, selection: Selection) -> tuple[str, ...]:
    """Return the selected fixed-step solvers; none for a DAE, which they cannot integrate."""
    native = any(backend.native for backend in selection.used_backends)
    if request.dae.algebraics or not native:
        return ()
    selected = selection.solvers or SOLVERS
    return tuple(n for n, solver in SOLVERS.items() if n in selected and not solver.adaptive)


def _possible(selection: Selection, progress: Progress) -> Selection:
    """Return the selection without the backends that need a missing C compiler."""
    if has_compiler():
        return selection
    if selection.backends and selection.backends != (Backend.INTERPRETED,):
        find_compiler()  # raises MissingTool
    progress("no C compiler: interpreted equations only")
    return replace(selection, backends=(Backend.INTERPRETED,))


def selected_outputs(requests: Sequence[RunRequest]) -> tuple[str, ...]:
    """Return the outputs whose errors are measured: the requested ones, or all shared ones."""
    first = requests[0]
    if first.outputs:
        return first.outputs
    own = first.dae.own_meanings if len(requests) > 1 else {}
    shared = [name for name in first.dae.observed if name not in own]
    for request in requests[1:]:
        known = set(observable(request.dae)) - request.dae.own_meanings.keys()
        shared = [name for name in shared if name in known]
    if not shared:
        raise UsageError(f"{first.dae.full_name}: the formulations have no output in common")
    return tuple(shared)


def small_request(request: RunRequest, outputs: tuple[str, ...]) -> RunRequest | None:
    """Return the request reduced to outputs; None if reduction removes nothing."""
    small = replace(request, outputs=outputs).reduced()
    return small if size(small.dae) != size(request.dae) else None


def run_configuration(configuration: Configuration, folder: Path) -> Trajectory:
    """Run a configuration; each FMU is exported once, to a folder."""
    request, interface = configuration.request, configuration.backend.interface
    if interface is None:
        return execute(request)
    small = "_reduced" if configuration.reduced else ""
    path = folder / f"{configuration.model.replace('/', '_')}{small}.fmu"
    if not path.exists():
        export_fmu(request.configured(), path)
    return run_file(request, path, interface)
