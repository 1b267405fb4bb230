"""Every way of running a model with events, and the rows of its tables that are known to fail."""

from collections.abc import Callable
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import fmpy
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

import cosim
from casadi_models.dae import Dae

COMPILED = ("dop853", "rk4", "ode8")
DRIVEN = ("cvodes", "erk", "rosenbrock", "idas")  # from Python
FMUS = {
    f"fmu{fmi} {name}": (fmi, interface, master)
    for fmi in (2, 3)
    for name, interface, master in (
        ("cs c", "CoSimulation", "c"),
        ("cs fmpy", "CoSimulation", "fmpy"),
        ("me fmpy", "ModelExchange", "fmpy"),
    )
}
ENGINES = (*COMPILED, *DRIVEN, *FMUS)
STEPPED = ("fmu2", "fmu3", "fmu3 events")  # whose inputs are set at communication points
_FOLDER = Path(mkdtemp(prefix="hybrid_fmus"))
_KNOWN = Path(__file__).parents[1] / "hybrid" / "known.txt"


@cache
def exported(dae: Dae, fmi: int, **options: object) -> Path:
    """Return an FMU of a model, made once in this process."""
    path = _FOLDER / f"{len(list(_FOLDER.iterdir()))}_{dae.name}.fmu"
    return cosim.export_fmu(dae, path, fmi=fmi, **options)


def run_on(engine: str, dae: Dae, **options: object) -> cosim.Trajectory:
    """Return the run of a model on one of `ENGINES`.

    Args:
        engine: One of `ENGINES`.
        dae: The model.
        options: `inputs`, `start_values`, `stop_time`, `output_interval`, as of `cosim.simulate`.

    Raises:
        CosimError: The run failed.
    """
    if engine not in FMUS:
        return cosim.simulate(dae, solver=engine, **options)
    fmi, interface, master = FMUS[engine]
    return cosim.simulate_fmu(exported(dae, fmi), interface=interface, master=master, **options)


def step_with_values(
    way: str, dae: Dae, name: str, values: list[float], interval: float
) -> dict[str, float]:
    """Return the final values of a co-simulation FMU whose input is set before each step.

    Args:
        way: One of `STEPPED`; with events, the input is set in event mode.
        dae: The model.
        name: Of its input.
        values: The input in each step.
        interval: Between communication points, s.
    """
    fmi = int(way[3])
    path = str(exported(dae, fmi))
    description, folder = fmpy.read_model_description(path), fmpy.extract(path)
    facts = {
        "guid": description.guid,
        "unzipDirectory": folder,
        "instanceName": "one",
        "modelIdentifier": description.coSimulation.modelIdentifier,
    }
    references = {v.name: v.valueReference for v in description.modelVariables}
    steps = _steps_of_fmi2 if fmi == 2 else _steps_of_fmi3
    fmu = steps(facts, references[name], values, interval, events=way.endswith("events"))
    read = fmu.getReal if fmi == 2 else fmu.getFloat64
    states = [variable.name for variable in dae.states]
    found = dict(zip(states, read([references[state] for state in states]), strict=True))
    fmu.terminate()
    fmu.freeInstance()
    return found


def _steps_of_fmi2(facts, reference, values, interval, *, events):
    fmu = FMU2Slave(**facts)
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.setReal([reference], values[:1])
    fmu.exitInitializationMode()
    for i, value in enumerate(values):
        fmu.setReal([reference], [value])
        fmu.doStep(i * interval, interval)
    return fmu


def _steps_of_fmi3(facts, reference, values, interval, *, events):
    fmu = FMU3Slave(**facts)
    fmu.instantiate(eventModeUsed=events)
    fmu.enterInitializationMode(startTime=0.0)
    fmu.setFloat64([reference], values[:1])
    fmu.exitInitializationMode()
    for i, value in enumerate(values):
        if events and i:
            fmu.enterEventMode()
        fmu.setFloat64([reference], [value])
        if events:
            fmu.updateDiscreteStates()
            fmu.enterStepMode()
        fmu.doStep(i * interval, interval)
    return fmu


@cache
def known_rows() -> dict[str, str]:
    """Return the reasons of known.txt by row, or by pattern of rows."""
    lines = _KNOWN.read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if line.strip() and not line.startswith("#")]
    return dict(line.split(": ", 1) for line in rows)


def judge(row: str, check: Callable[[], None]) -> str:
    """Return what is wrong with a row of a table, or nothing; a row of known.txt must fail.

    Args:
        row: Its id, as in known.txt.
        check: Raises AssertionError or CosimError where the product is wrong.
    """
    reasons = [reason for pattern, reason in known_rows().items() if fnmatchcase(row, pattern)]
    try:
        check()
    except (AssertionError, cosim.CosimError) as error:
        return "" if reasons else f"{row}: {str(error).splitlines()[0]}"
    return f"{row}: right now, remove it from known.txt: {reasons[0]}" if reasons else ""
