"""`tradeoff`: run every selected configuration of a scene, several times, in turn."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter

from cosim.codegen.cache import private_folder
from cosim.codegen.compiler import find_compiler, has_compiler
from cosim.errors import CosimError, UsageError
from cosim.host.temporary import temporary_folder
from cosim.integrate.solvers import SOLVERS
from cosim.model.catalogue import load
from cosim.scene.roads import Road
from cosim.scene.scene import Scene
from cosim.study.tradeoff.configuration import Configuration, Selection
from cosim.study.tradeoff.convergence import observed_order
from cosim.study.tradeoff.measurement import failed_event, gather, invariants, observed_event
from cosim.study.tradeoff.record import Event, Record
from cosim.study.tradeoff.result import Tradeoff, provenance
from cosim.study.tradeoff.rounds import Tell, measure
from cosim.study.tradeoff.stability import stability_limit
from cosim.study.tradeoff.variants import Workshop, kept_outputs, members, span
from cosim.verify.reference import Reference, reference

REPEATS = 5
SECONDS = 240.0  # from the beginning of a study until its last run begins


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
        seconds: Time from the beginning after which no run begins. What has not run by then is
            listed as left out; what has run once has that run's time.
        resume: Whether to go on where an interrupted study of the same scene stopped.
        tell: Called with a line of progress before and after each run.

    Raises:
        CosimError: The scene cannot be run at all, or there is no reference for it.

    Example:
        >>> from cosim.study.tradeoff.configuration import Selection
        >>> few = Selection(solvers=("erk",), tolerances=(1e-6, 1e-9), roads=("native",))
        >>> study = tradeoff("crank_shaft/driven", selection=few, repeats=1)
        >>> len(study.measurements)
        2
    """
    if isinstance(scene, str):
        if every_formulation is None:
            every_formulation = "/" not in scene and ".py:" not in scene
        scene = Scene(scene, load(scene))
    if not isinstance(scene, Scene):
        raise UsageError.of_type("tradeoff", scene, "a Scene, or the name of a model")
    if not isinstance(repeats, int) or repeats < 0:
        raise UsageError(f"tradeoff: repeats = {repeats!r}; give a whole number, 0 or more")
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
    with temporary_folder() as folder:
        workshop = Workshop({s.dae.full_name: s for s in scenes}, kept, Path(folder))
        wanted = configurations(workshop, scene, selection)

        def run(configuration: Configuration) -> Event:
            try:
                trajectory = workshop.run(configuration)
            except CosimError as error:
                return failed_event(configuration, error)
            return observed_event(configuration, trajectory, truth, kept, constant)

        events = [event for event in events if event.configuration in wanted]
        measure(wanted, events, run, record, repeats, began + seconds, tell)
        impossible = _impossible(workshop, selection)
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
        _run_facts(scene) | provenance(truth),
        impossible,
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


def _run_facts(scene: Scene) -> dict[str, str]:
    """Return what was run: the values that the scene sets, and the output times."""
    begin, end = span(scene)
    interval = scene.configured().experiment.output_interval
    values = ", ".join(f"{name} = {value:.6g}" for name, value in scene.values.items())
    facts = {"values": values} if values else {}
    return facts | {"output times": f"{begin:g} to {end:g} s, every {interval:g} s"}


def _impossible(workshop: Workshop, selection: Selection) -> tuple[tuple[str, str], ...]:
    """Return what is not measured because it cannot be, each with the reason."""
    found = [pair for _, dae, _ in workshop.pairs() for pair in selection.impossible(dae)]
    if not has_compiler():
        compiling = ", ".join(road for road in Road if road is not Road.INTERPRETED)
        found.append((compiling, "no C compiler"))
    return tuple(found)


def _fixed_step_solvers(scene: Scene, selection: Selection) -> tuple[str, ...]:
    """Return the selected solvers of fixed steps; none for a DAE, which they cannot integrate."""
    if scene.dae.algebraics or not any(road.native for road in selection.ways):
        return ()
    wanted = selection.solvers or SOLVERS
    return tuple(n for n, solver in SOLVERS.items() if n in wanted and not solver.adaptive)


def _possible(selection: Selection, tell: Tell) -> Selection:
    """Leave out what needs a C compiler where there is none, unless it is asked for by name."""
    if has_compiler():
        return selection
    if selection.roads and selection.roads != (Road.INTERPRETED,):
        find_compiler()  # says what is missing
    tell("no C compiler: interpreted equations only")
    return replace(selection, roads=(Road.INTERPRETED,))


def study_record(truth: Reference) -> Record:
    """Return where the runs of a study are kept."""
    return Record(private_folder() / "tradeoffs" / f"{truth.key}.jsonl", truth.key)
