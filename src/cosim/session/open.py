"""`open`: begin a session of a model, an FMU or a system."""

import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, Unpack, overload

from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.coupling.files import is_system, read_system
from cosim.coupling.settings import Method
from cosim.coupling.system import System
from cosim.errors import FmuError, UsageError
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.description import Interface
from cosim.fmi.run.opened import OpenedFmu
from cosim.host.temporary import temporary_folder
from cosim.integrate.ensemble.simulate_many import lane_solver
from cosim.integrate.keywords import requested
from cosim.integrate.solvers import with_largest_step
from cosim.memo import cached_per_thread
from cosim.model.values import number, whole
from cosim.session.copies import Copies
from cosim.session.lane_copies import LaneCopies
from cosim.session.restart import Experiment
from cosim.session.session import Session
from cosim.session.single_copies import SingleCopies
from cosim.session.system_session import SystemSession

_MOST_INSTANCES = 100_000  # of an FMU, each of which is called alone


class SessionKeywords(TypedDict, total=False):
    """Keywords of `open` for one session and for copies."""

    start_time: float | None
    stop_time: float | None
    relative_tolerance: float | None
    solver: str | None
    accuracy: float | None
    macro_step: float | None
    method: str | None


@overload
def open(
    model: Dae | System | str | os.PathLike[str],
    *,
    copies: None = None,
    start_values: Mapping[str, float | str] | None = None,
    **keywords: Unpack[SessionKeywords],
) -> Session | SystemSession: ...
@overload
def open(
    model: Dae | System | str | os.PathLike[str],
    *,
    copies: int,
    start_values: Mapping[str, ArrayLike | str] | None = None,
    **keywords: Unpack[SessionKeywords],
) -> Copies: ...
def open(
    model: Dae | System | str | os.PathLike[str],
    *,
    copies: int | None = None,
    start_values: Mapping[str, Any] | None = None,
    **keywords: Unpack[SessionKeywords],
) -> Session | SystemSession | Copies:
    """Begin a session: a model that stays alive, is advanced step by step, saved and restored.

    A model runs as compiled code of its FMU for co-simulation, in this process; the first session
    of a model compiles it. The binary of an FMU from elsewhere runs in this process, too: only open
    FMUs you trust. A run with the same communication points as the session has the same bits.

    Args:
        model: A `Dae`, the name of a model, "PATH.py:FUNCTION", the file of an FMU for
            co-simulation, or a `System` or its file, whose variables are called `part.variable`.
            One with FMUs as parts is advanced by the master of `System.simulate`.
        copies: Number of copies that are advanced together, explicit models without events in
            SIMD lanes and threads; one session when None.
        start_values: Start values, parameters and constant inputs by name, as in `simulate`; of
            copies also arrays, (copies,).

    Keyword Args:
        start_time: s; 0, or that of the FMU, when None.
        stop_time: End that the FMU learns, s, and rejects steps beyond it; none when None.
        relative_tolerance: Of the solver in the FMU; that of its default experiment when None.
        solver: Of a model, as in `export_fmu`.
        macro_step, method, accuracy: Of a system with FMUs as parts, as in `System.simulate`. Each
            call of `advance` ends a macro step. An accuracy, 1e-6 if neither this nor macro_step is
            given, chooses macro steps by their estimated error; no second run checks it.

    Returns:
        The session or the copies, at the start time; a context manager that closes itself.

    Raises:
        UnknownName, UsageError, ParameterError, InitialConditionError: A name or a value does not
            fit.
        FmuError: The file is no FMU for co-simulation that can run here, or its initialization
            failed.
        MissingTool: A model needs a compiler, and none works.

    Example:
        >>> import cosim
        >>> with cosim.open("bicycle", start_values={"speed": "4 m/s"}) as bike:
        ...     bike.set(steer_torque="0.3 N.m")
        ...     events = bike.advance(0.01)
        ...     saved = bike.save()
        ...     events = bike.advance(to=0.5)
        ...     bike.restore(saved)
        ...     bike.time, bike.get(["phi", "delta"]).shape
        (0.01, (2,))
    """
    if isinstance(model, str | os.PathLike) and (
        is_system(model) or Path(model).suffix.lower() == ".toml"
    ):
        model = read_system(model)
    coupled = {"accuracy", "macro_step", "method"} & {
        n for n, v in keywords.items() if v is not None
    }
    if isinstance(model, System) and not model.is_model:
        return _open_system(model, copies, start_values or {}, keywords)
    if coupled:
        raise UsageError(f"{min(coupled)} is for systems with FMUs as parts; leave it out")
    if isinstance(model, System):
        model = model.dae
    if copies is not None:
        whole("open", "copies", copies)
    names = "start_time", "stop_time", "relative_tolerance"
    facts: dict[str, Any] = {name: keywords.get(name) for name in names}
    start_time, stop_time, solver = facts["start_time"], facts["stop_time"], keywords.get("solver")
    if stop_time is None and start_time is not None:  # any span that follows
        facts["stop_time"] = number("open", "start_time", start_time) + 1.0
    if isinstance(model, os.PathLike) or (
        isinstance(model, str) and model.lower().endswith(".fmu")
    ):
        if solver is not None:
            raise UsageError(f"{model}: an FMU has its own solver; leave solver out")
        file, dae = OpenedFmu(model), None
        if file.interface is Interface.MODEL_EXCHANGE:
            raise FmuError(
                f"{file.path} is for model exchange only; the solver of a system integrates it: "
                f"cosim.open(cosim.couple({{'part': {str(model)!r}}}, {{}}))"
            )
    else:
        asked = requested(model, **facts)
        dae = asked.dae
        lanes = lane_solver(with_largest_step(asked))
        if copies is not None and lanes is not None and solver in (None, lanes.name):
            engine = LaneCopies(dae, copies, lanes.tolerance, stop_time)
            return Copies(engine, copies, start_values or {}, asked.times.span(dae)[0])
        file = _exported(dae, solver)
    request = file.request(**facts)
    stop = None if stop_time is None else request.stop
    experiment = Experiment(request.start, stop, request.tolerance)
    if copies is None:
        return Session(file, start_values or {}, experiment, dae)
    several = _several(partial(Session, file, {}, experiment, dae), copies)
    return Copies(several, copies, start_values or {}, experiment.startTime)


@cached_per_thread(8)
def _exported(dae: Dae, solver: str | None) -> OpenedFmu:
    """Return the FMU of a model, which is exported once."""
    with temporary_folder() as folder:
        found = OpenedFmu(export_fmu(dae, folder / "model.fmu", fmi=3, solver=solver))
    found.path = dae.full_name  # what messages name
    return found


def _several(make: Callable[[], Session | SystemSession], copies: int) -> SingleCopies:
    """Return sessions; if one cannot be opened, those before are closed."""
    whole("open", "copies", copies, most=_MOST_INSTANCES)
    sessions = list[Session | SystemSession]()
    with ExitStack() as opened:
        for _ in range(copies):
            sessions.append(make())
            opened.callback(sessions[-1].close)
        opened.pop_all()
    return SingleCopies(sessions)


def _open_system(
    system: System, copies: int | None, values: Mapping[str, Any], keywords: SessionKeywords
) -> SystemSession | Copies:
    """Return sessions of a system that the master of `System.simulate` advances."""
    if keywords.get("solver") is not None:
        raise UsageError(f"{system.name}: its parts have their own solvers; leave solver out")
    start, stop = keywords.get("start_time"), keywords.get("stop_time")
    ends = stop is not None
    if start is not None and stop is None:  # what follows is as long as usual
        usual_start, usual_stop, _ = system.times(None, None, None)
        stop = number("open", "start_time", start) + usual_stop - usual_start
    settings = system.settings(
        start_time=start,
        stop_time=stop,
        accuracy=keywords.get("accuracy"),
        macro_step=keywords.get("macro_step"),
        method=keywords.get("method") or Method.ITERATED,
        relative_tolerance=keywords.get("relative_tolerance"),
    )
    if copies is None:
        return SystemSession(system, values, settings, ends=ends)
    several = _several(partial(SystemSession, system, {}, settings, ends=ends), copies)
    return Copies(several, copies, values, settings.start)
