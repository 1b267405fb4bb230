"""Cost of sessions: a step, a saved state, a Kalman filter, against FMPy's own loops and heyoka.

Prints medians for the bicycle: 10 ms with one input and two outputs from Python through a session,
through FMPy's objects, by heyoka's stepper, and the time of the C function alone; save and restore,
and the C functions in them; a step of the filter of `examples/filter_roll.py`, of the same filter
over FMPy's objects, and of one that calls `fmpy.simulate_fmu` for each prediction and for its
differences; copies in lanes, against `simulate_many`. Rows that are compared are interleaved.
"""

import statistics
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Slave

import cosim
from cosim.integrate.integrator import start_vectors

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from filter_roll import DISTURBED, NAMES, NOISE, START, STEP, filtered

OUTPUTS = ("phi", "delta")
TOLERANCE = 1e-9  # of the FMU for co-simulation


def nothing() -> None:
    """Do nothing: what the clock itself costs."""


def medians(calls, repeats: int, *, before=None) -> dict[str, float]:
    """Return the median time of each call, us, without that of the clock.

    Args:
        calls: By name, interleaved in rounds of ten, as machines change their speed.
        repeats: Of each.
        before: What is done before a call, and not timed, by name.
    """
    calls, before = {**calls, "": nothing}, before or {}
    times = {name: [] for name in calls}
    for _ in range(max(repeats // 10, 1)):
        for name, call in calls.items():
            for _ in range(10):
                before.get(name, nothing)()
                began = perf_counter()
                call()
                times[name].append(perf_counter() - began)
    found = {name: 1e6 * statistics.median(each) for name, each in times.items()}
    return {name: value - found[""] for name, value in found.items() if name}


def shown(found: dict[str, float]) -> None:
    """Print times, us."""
    for name, value in found.items():
        print(f"{name:44}{value:10.2f} us")


class OverFmpy:
    """The bicycle through FMPy's objects, as its documentation shows."""

    def __init__(self, path: Path) -> None:
        folder = fmpy.extract(path)
        self.description = description = fmpy.read_model_description(folder)
        known = {v.name: v.valueReference for v in description.modelVariables}
        self.known = known
        self.rates = [item.variable.valueReference for item in description.derivatives]
        self.states = [item.variable.derivative for item in description.derivatives]
        identifier = description.coSimulation.modelIdentifier
        self.fmu = FMU3Slave(
            guid=description.guid, unzipDirectory=folder, modelIdentifier=identifier
        )
        self.fmu.instantiate()
        self.begin({})

    def begin(self, start: dict[str, float]) -> None:
        self.fmu.enterInitializationMode(startTime=0.0, tolerance=TOLERANCE)
        self.fmu.setFloat64([self.known[name] for name in start], [*start.values()])
        self.fmu.exitInitializationMode()
        self.time, self.torque = 0.0, 0.3

    def step(self) -> list[float]:
        self.torque = -self.torque
        self.fmu.setFloat64([self.known["steer_torque"]], [self.torque])
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=STEP)
        self.time += STEP
        return self.fmu.getFloat64([self.known[name] for name in OUTPUTS])

    def filtered(self, measured: np.ndarray) -> np.ndarray:
        x, P = np.zeros(4), np.diag([0.1, 0.1, 0.5, 0.5]) ** 2
        C, found = np.eye(4)[:1], []
        kept = [[v.name for v in self.states].index(name) for name in NAMES]
        references = [self.known[name] for name in NAMES]
        for angle in measured:
            K = P @ C.T / (C @ P @ C.T + NOISE**2)
            x = x + K[:, 0] * (angle - x[0])
            P = (np.eye(4) - K @ C) @ P
            found.append(x)
            self.fmu.reset()
            self.begin(dict(zip(NAMES, x.tolist(), strict=True)))
            columns = [
                self.fmu.getDirectionalDerivative(self.rates, [v.valueReference], [1.0])
                for v in self.states
            ]
            A = np.array(columns).T[np.ix_(kept, kept)] * STEP
            F = np.eye(4) + A + A @ A / 2
            self.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=STEP)
            x, P = np.array(self.fmu.getFloat64(references)), F @ P @ F.T + DISTURBED
        return np.array(found)


def filtered_by_runs(path: Path, measured: np.ndarray) -> np.ndarray:
    """Filter with runs of FMPy: one for the prediction, and one for each column of F."""
    x, P = np.zeros(4), np.diag([0.1, 0.1, 0.5, 0.5]) ** 2
    C, found, change = np.eye(4)[:1], [], 1e-6

    def ahead(x: np.ndarray) -> np.ndarray:
        start = dict(zip(NAMES, x.tolist(), strict=True))
        run = fmpy.simulate_fmu(
            path, start_values=start, stop_time=STEP, output_interval=STEP, output=NAMES
        )
        return np.array([run[name][-1] for name in NAMES])

    for angle in measured:
        K = P @ C.T / (C @ P @ C.T + NOISE**2)
        x = x + K[:, 0] * (angle - x[0])
        P = (np.eye(4) - K @ C) @ P
        found.append(x)
        predicted = ahead(x)
        F = np.column_stack([ahead(x + change * e) - predicted for e in np.eye(4)]) / change
        x, P = predicted, F @ P @ F.T + DISTURBED
    return np.array(found)


def copies(count: int, rounds: int) -> None:
    """Print what one call costs for many copies, against the same span of `simulate_many`."""
    start = {"phi": np.linspace(-0.05, 0.05, count), "speed": 5.0}
    torque = np.resize([0.3, -0.3], count)
    many, one, steps = [], [], []
    with cosim.open("bicycle", copies=count, start_values=start) as bikes:
        for _ in range(rounds):  # side by side: machines change their speed
            began = perf_counter()
            cosim.simulate_many("bicycle", start, output_times=[0.0, 1.0])
            many.append(perf_counter() - began)
            bikes.reset()
            began = perf_counter()
            bikes.advance(1.0)
            one.append(perf_counter() - began)
            bikes.reset()
            began = perf_counter()
            for k in range(100):
                bikes.set(steer_torque=torque * (-1) ** k)
                bikes.advance(STEP)
                bikes.get(OUTPUTS)
            steps.append(perf_counter() - began)
    best = {"simulate_many, 1 s": many, "one call, 1 s": one, "100 calls with inputs": steps}
    for name, times in best.items():
        print(f"{count} copies: {name:24}{1e3 * statistics.median(times):8.2f} ms")


def heyoka_step(dae):
    """Return a step of heyoka's with an alternating torque; None where it is not installed."""
    sys.path.append(str(Path(__file__).parent / "peers"))
    try:
        import with_heyoka
    except ImportError as missing:
        print(f"heyoka is not measured: {missing}; pip install 'cosim-rigid[benchmarks]'")
        return None
    start, names = start_vectors(dae), [v.name for v in dae.states]
    places = [names.index(name) for name in OUTPUTS]
    x0, p = (np.array(start[name]).ravel() for name in ("x0", "p"))
    advance = with_heyoka.stepper(dae, x0, p, places, tolerance=TOLERANCE, step=STEP)
    torque = 0.3

    def step() -> list[float]:
        nonlocal torque
        torque = -torque
        return advance([torque, 0.0, 0.0])

    return step


def steps_and_states(bike, other: OverFmpy, samples: int) -> None:
    """Print what a step costs, and save and restore, with what the C functions cost in them."""
    torque = 0.3

    def step() -> None:
        nonlocal torque
        torque = -torque  # which keeps the bicycle upright
        bike.set(steer_torque=torque)
        bike.advance(STEP)
        bike.get(OUTPUTS)

    calls = bike._calls  # the C function alone, after an input is set

    def ready() -> None:
        step()
        bike.set(steer_torque=-torque)
        calls._time.value, calls._length.value = bike.time, STEP

    def alone() -> None:
        calls._do_step(*calls._arguments)

    rows = {"solver, 10 ms": alone, "session: set, advance, get": step}
    rows["FMPy: setFloat64, doStep, getFloat64"] = other.step
    if taylor := heyoka_step(cosim.load("bicycle")):
        rows["heyoka: set, step, read"] = taylor
    step()
    saved = bike.save()

    def back() -> None:
        bike.restore(saved)

    before = {"solver, 10 ms": lambda: (back(), ready()), "session: set, advance, get": back}
    shown(medians(rows, samples, before=before))
    back()
    states = bike._states
    version = calls.function("GetVersion")
    instance, place, content = states._instance, states._at_state, saved
    rows = {
        "session: save": bike.save,
        "session: restore": back,
        "fmi3GetFMUState alone, by ctypes": lambda: states._take[0](instance, place),
        "fmi3SetFMUState alone, by ctypes": lambda: states._put[0](instance, content),
        "a call by ctypes that does nothing": version,
    }
    shown(medians(rows, samples))


def filters(bike, other: OverFmpy, path: Path, samples: int) -> None:
    """Print what a step of the Kalman filter costs."""
    truth = cosim.simulate("bicycle", start_values=START, stop_time=2.0, outputs=NAMES)
    measured = truth["phi"] + np.random.default_rng(1).normal(0.0, NOISE, len(truth))
    ways = {
        "session: a step of the filter": lambda: filtered(measured, bike)[0],
        "FMPy's objects: a step of the filter": lambda: other.filtered(measured),
    }
    results, times = {}, {name: [] for name in ways}
    for _ in range(1 + samples // 100):
        for name, run in ways.items():
            began = perf_counter()
            results[name] = run()
            times[name].append(1e6 * (perf_counter() - began) / len(measured))
    shown({name: statistics.median(each) for name, each in times.items()})
    one, another = results.values()
    print(f"largest difference: {np.abs(one - another).max():.1e}")
    unpacked = fmpy.extract(path)
    for name, file in (("file", path), ("folder", unpacked)):
        began = perf_counter()
        found = filtered_by_runs(file, measured[:10])
        each = 1e6 * (perf_counter() - began) / len(found)
        shown({f"fmpy.simulate_fmu of the {name}: a step": each})
    print(f"largest difference: {np.abs(one[:10] - found).max():.1e}")


def main(samples: int) -> None:
    copies(1000 if samples > 1000 else 50, 9 if samples > 1000 else 2)
    with cosim.open("bicycle") as bike, tempfile.TemporaryDirectory() as folder:
        path = cosim.export_fmu(cosim.load("bicycle"), Path(folder) / "bike.fmu", fmi=3)
        other = OverFmpy(path)
        steps_and_states(bike, other, samples)
        bike.reset()
        other.fmu.reset()
        filters(bike, other, path, samples)


if __name__ == "__main__":
    main(200 if "--short" in sys.argv else 2000)
