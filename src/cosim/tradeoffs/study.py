"""`tradeoff`: run every selected configuration of a scene, several times, in turn."""

import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

from cosim.compile import find_compiler, has_compiler
from cosim.errors import CosimError, UsageError
from cosim.loading import load
from cosim.references import Reference, reference
from cosim.resources import cache_folder
from cosim.runge_kutta import METHODS
from cosim.scene import Scene
from cosim.tradeoffs.configuration import COMPILED, INTERPRETED, Configuration, Selection
from cosim.tradeoffs.events import Event, Record
from cosim.tradeoffs.measurement import failed_event, gather, invariants, observed_event
from cosim.tradeoffs.orders import observed_order
from cosim.tradeoffs.result import Tradeoff, provenance
from cosim.tradeoffs.stability import stability_limit
from cosim.tradeoffs.workshop import Workshop, kept_outputs, members, span

REPEATS = 5
SECONDS = 200.0  # of the whole study; what has not been timed by then is timed once
SLOW = 20.0  # s; what takes longer is not run with tighter tolerances or smaller steps
Tell = Callable[[str], None]


def tradeoff(
    scene: Scene | str,
    *,
    selection: Selection | None = None,
    every_formulation: bool | None = None,
    repeats: int = REPEATS,
    seconds: float = SECONDS,
    resume: bool = False,
    tell: Tell | None = None,
) -> Tradeoff:
    """Measure error against cost.

    Every configuration runs once for its error and its counts; then all of them are timed in turn,
    so that what else the machine does strikes all of them alike.

    Args:
        scene: A scene, `MODEL`, `MODEL/FORMULATION` or `PATH.py:FUNCTION`.
        selection: Which solvers, tolerances, steps and roads.
        every_formulation: Whether the model's other formulations are measured, too; unless one is
            named when None.
        repeats: Most timed runs of each configuration.
        seconds: Time from the beginning after which no second timed run of anything begins.
        resume: Whether to go on where an interrupted study of the same scene stopped.
        tell: Called with a line of progress before and after each run.

    Raises:
        CosimError: The scene cannot be run at all, or there is no reference for it.
    """
    if isinstance(scene, str):
        if every_formulation is None:
            every_formulation = "/" not in scene and ".py:" not in scene
        scene = Scene(scene, load(scene))
    began, tell = perf_counter(), tell or (lambda _: None)
    selection = _possible(selection or Selection(), tell)
    if not scene.dae.states:
        raise UsageError(f"{scene.name} has no states: there is nothing to integrate")
    scenes = members(scene, every_formulation=every_formulation is not False)
    kept = kept_outputs(scenes)
    tell("reference ...")
    truth = reference(scene)
    tell(f"reference: {truth}")
    constant = invariants(truth)
    record = study_record(truth)
    events = record.begin(resume=resume)
    with tempfile.TemporaryDirectory(prefix="cosim-") as folder:
        workshop = Workshop({s.dae.full_name: s for s in scenes}, kept, Path(folder))
        wanted = configurations(workshop, scene, selection)

        def run(configuration: Configuration) -> Event:
            try:
                trajectory = workshop.run(configuration)
            except CosimError as error:
                return failed_event(configuration, error)
            return observed_event(configuration, trajectory, truth, kept, constant)

        events = [event for event in events if event.configuration in wanted]
        _measure(wanted, events, run, record, repeats, began + seconds, tell)
    ordered = sorted(events, key=lambda event: wanted.index(event.configuration))
    fixed = _fixed_step_solvers(scene, selection)
    limits = [stability_limit(scene, truth, solver) for solver in fixed]
    return Tradeoff(
        scene.name,
        kept,
        constant,
        truth,
        gather(ordered),
        tuple(observed_order(scene, truth, solver) for solver in fixed),
        tuple(limit for limit in limits if limit is not None),
        provenance(truth),
    )


def configurations(
    workshop: Workshop, scene: Scene, selection: Selection
) -> tuple[Configuration, ...]:
    """Return what is to be measured.

    Raises:
        UsageError: The selection fits no formulation.
    """
    begin, end = span(scene)
    interval = scene.configured().experiment.output_interval
    found = tuple(
        configuration
        for _, full, small in workshop.pairs()
        for configuration in selection.configurations(full, small, end - begin, interval)
    )
    if not found:
        raise UsageError(
            f"{scene.name}: nothing to measure with solvers {', '.join(selection.solvers)} on "
            f"{', '.join(selection.roads) or 'any road'}; an FMU has its own solvers"
        )
    return found


def _fixed_step_solvers(scene: Scene, selection: Selection) -> tuple[str, ...]:
    """Return the selected solvers of fixed steps; none for a DAE, which they cannot integrate."""
    if scene.dae.algebraics or not set(selection.roads or (COMPILED,)) & {COMPILED, INTERPRETED}:
        return ()
    return tuple(name for name in METHODS if name in (selection.solvers or METHODS))


def _possible(selection: Selection, tell: Tell) -> Selection:
    """Leave out what needs a C compiler where there is none, unless it is asked for by name."""
    if has_compiler():
        return selection
    if selection.roads and selection.roads != (INTERPRETED,):
        find_compiler()  # says what is missing
    tell("no C compiler: interpreted equations only")
    return replace(selection, roads=(INTERPRETED,))


def study_record(truth: Reference) -> Record:
    """Return where the runs of a study are kept."""
    return Record(cache_folder() / "tradeoffs" / f"{truth.key}.jsonl", truth.key)


def _measure(
    wanted: Sequence[Configuration],
    events: list[Event],
    run: Callable[[Configuration], Event],
    record: Record,
    repeats: int,
    deadline: float,
    tell: Tell,
) -> None:
    """Run what the events lack, one round after the other."""
    counts = Counter(event.configuration for event in events)
    took = {e.configuration: e.total_time for e in events}
    failed = {e.configuration for e in events if not e.errors}
    for number in range(repeats + 1):
        began = perf_counter()
        for i, configuration in enumerate(wanted, start=1):
            if counts[configuration] > number or configuration in failed:
                continue
            if number > 1 and perf_counter() > deadline:
                return
            slow = _slower_one(configuration, took) if number == 0 else None
            if slow is not None:
                event = Event(configuration, status=f"left out: {slow} took more than {SLOW:g} s")
            elif number and (took[configuration] or 0.0) > SLOW / 10:
                continue  # long runs need no repetition
            else:
                event = run(configuration)
            record.append(event)
            events.append(event)
            counts[configuration] += 1
            if number == 0:
                took[configuration] = event.total_time
                if not event.errors:
                    failed.add(configuration)
                tell(f"{i}/{len(wanted)} {_said(event)}")
        tell(f"round {number} of {repeats}: {perf_counter() - began:.0f} s")


def _slower_one(
    configuration: Configuration, took: dict[Configuration, float | None]
) -> Configuration | None:
    """Return a coarser configuration of the same family that was slow already."""
    for other, time in took.items():
        coarser = (other.tolerance or 0) > (configuration.tolerance or 0) or (other.step or 0) > (
            configuration.step or 0
        )
        if other.family == configuration.family and coarser and (time or 0.0) > SLOW:
            return other
    return None


def _said(event: Event) -> str:
    if not event.errors:
        return f"{event.configuration}: {event.status}"
    worst = max(event.errors, key=event.errors.__getitem__)
    calls = "" if event.rhs_calls is None else f", {event.rhs_calls} calls"
    time = event.solver_time if event.solver_time is not None else event.total_time
    told = "" if time is None else f", {1e3 * time:.2f} ms"
    return f"{event.configuration}: error {event.errors[worst]:.1e} ({worst}){calls}{told}"
