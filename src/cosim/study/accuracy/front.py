"""The measured front of a model: which error each solver makes at each tolerance, in which time.

It is measured once, on road one, at the model's own values and over its own span, and kept in the
cache under a hash of equations, values, outputs, solvers, versions and machine.
"""

import hashlib
import json
import os
import platform
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.cache import content_of, keep
from cosim.codegen.compiler import find_compiler
from cosim.errors import CacheError, CosimError
from cosim.integrate.engine import Problem
from cosim.integrate.run.outputs import all_columns
from cosim.integrate.run.worthwhile import worthwhile
from cosim.integrate.solvers import chosen_solver, engine_of
from cosim.scene.roads import Road
from cosim.scene.scene import Scene
from cosim.study.tradeoff.configuration import Configuration, Selection
from cosim.study.tradeoff.measurement import Measurement, gather, observed_event
from cosim.study.tradeoff.record import Event
from cosim.study.tradeoff.result import pareto_front
from cosim.study.tradeoff.variants import Workshop, span
from cosim.verify.reference import Reference, reference, reference_key

FRONT_TOLERANCES = (*(float(f"1e-{i}") for i in range(2, 14)), 3e-14)
ROUNDS = 4  # of which the fastest counts: what else the machine does makes a run slower only
TIMING_SECONDS = 5.0  # after which no configuration is timed once more
MOST_CALLS = 200_000  # of the equations; a solver that needs more is not tried any tighter
_FRONT_FORMAT = "front-4"


@dataclass(frozen=True)
class Front:
    """What was measured of a model.

    Attributes:
        events: The fastest run of each configuration, with the error of every variable.
        rounding: What double precision leaves uncertain in each variable, in nominal values.
    """

    events: tuple[Event, ...]
    rounding: Mapping[str, float]

    def cheapest_first(
        self, names: Sequence[str], *, without: Collection[str] = ()
    ) -> tuple[Measurement, ...]:
        """Return what no other configuration beats in time and in the error of some variables.

        Args:
            names: The variables.
            without: Solvers to leave out.
        """
        kept = [
            replace(event, errors={name: event.errors[name] for name in names})
            for event in self.events
            if event.configuration.solver not in without
        ]
        return pareto_front(gather(kept), "solver_time", 0.0)


def measured_front(dae: Dae, *, compiled: bool) -> Front:
    """Return the front of a model, from the cache if it is there.

    Args:
        dae: The model; its own values and span are what is measured.
        compiled: Whether its equations are compiled.

    Raises:
        CosimError: The model cannot be run; see `reference`.
    """
    every = tuple(column.name for column in all_columns(dae))
    scene = Scene(dae.full_name, replace(dae, observed=every))
    key = _front_key(scene, compiled)
    entry = f"fronts/{key}"
    return _read_front(entry) or _measured_front(scene, compiled, entry)


def pays_compiling(dae: Dae, grid: Vector) -> bool:
    """Tell whether to compile a model's equations for all the runs of a front over these times."""
    solver, problem = chosen_solver(dae), Problem(dae, grid.tobytes(), None, True)
    runs = len(FRONT_TOLERANCES) * len(solvers(dae, compiled=True))
    build = partial(engine_of, problem, solver)
    return worthwhile(dae, solver, len(grid), build, runs).compiled


def solvers(dae: Dae, *, compiled: bool) -> tuple[str, ...]:
    """Return the solvers that are measured: of different kinds, so that each can check another."""
    own = ("idas", "rosenbrock") if dae.algebraics else ("cvodes", "erk")
    return (*own, "dop853") if compiled else own


def _front_key(scene: Scene, compiled: bool) -> str:
    compiler = " ".join(find_compiler()) if compiled else "interpreted"
    machine = (platform.node(), platform.machine(), os.cpu_count())
    facts = (
        _FRONT_FORMAT,
        version("cosim-rigid"),
        solvers(scene.dae, compiled=compiled),
        FRONT_TOLERANCES,
    )
    text = repr((reference_key(scene), scene.dae.full_name, facts, compiler, machine))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _measured_front(scene: Scene, compiled: bool, entry: str) -> Front:
    dae = scene.configured()
    best = reference(scene)
    workshop = Workshop({dae.full_name: scene}, dae.observed, Path())
    begin, end = span(scene)
    road = Road.NATIVE if compiled else Road.INTERPRETED
    selection = Selection(solvers(dae, compiled=compiled), FRONT_TOLERANCES, (), (road,))
    wanted = selection.configurations(dae, None, end - begin, dae.experiment.output_interval)
    events: dict[Configuration, Event] = {}
    # Calls of each solver's last run, which repeat whatever else the machine does, as times do not
    calls: dict[str, float] = {}
    for configuration in wanted:  # of each solver, the loosest tolerance first
        solver = configuration.solver
        if calls.get(solver, 0) > MOST_CALLS:
            continue
        event = _event(workshop, configuration, best)
        if event is not None:
            events[configuration] = event
            calls[solver] = event.rhs_calls or 0
        elif solver in calls:  # too tight; the first ones may be too loose
            calls[solver] = float("inf")
    began = perf_counter()
    for _ in range(ROUNDS - 1):
        for configuration, event in events.items():
            if perf_counter() - began < TIMING_SECONDS:
                again = _event(workshop, configuration, best) or event
                events[configuration] = min(event, again, key=lambda e: e.run_time)
    rounding = {
        name: float(np.spacing(np.abs(best.run[name]).max())) / best.run.column(name).nominal
        for name in best.run.names
    }
    front = Front(tuple(events.values()), rounding)
    _keep_front(front, entry)
    return front


def _event(workshop: Workshop, configuration: Configuration, best: Reference) -> Event | None:
    """Return what a run took and how far it was off, no less than the reference itself may be."""
    try:
        run = workshop.run(configuration)
    except CosimError:
        return None
    event = observed_event(configuration, run, best, best.run.names, ())
    errors = {name: max(error, best.errors[name]) for name, error in event.errors.items()}
    return replace(event, errors=errors)


def _keep_front(front: Front, entry: str) -> None:
    """Write to the cache; without one, the front is measured again next time."""
    facts = {"rounding": front.rounding, "events": [asdict(event) for event in front.events]}
    with suppress(OSError, CacheError):
        keep(entry, json.dumps(facts).encode())


def _read_front(entry: str) -> Front | None:
    content = content_of(entry)
    if content is None:
        return None
    try:
        facts = json.loads(content)
        return Front(tuple(map(Event.of, facts["events"])), facts["rounding"])
    except (ValueError, KeyError, TypeError):
        return None  # of another version
