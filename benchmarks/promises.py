"""How often `accuracy` keeps what it promises: random parameters and starts of every system.

    python benchmarks/promises.py [--samples 40] [--seed 1] [MODEL ...]

Each parameter is multiplied by a factor between 1/2 and 2, uniform in its logarithm; each start,
too, and up to half a nominal value is added or taken away. What the model refuses is drawn again.
A motion that leaves the model's limits or has no end, like a bicycle that falls over, is counted by
itself: it has no error that could be promised, and must not pass without a word.

The true error is that from `cosim.reference` of the very sample: of several methods at their
tightest, the one that agrees best with another. Where its own error is more than a tenth of what
was asked for, nothing can be judged.

kept       of the runs that were returned, those whose true error is not above what was asked for
chosen     the same of the cheapest configuration, which is run once more by itself
worst      largest true error over what was asked for, of each
estimate   smallest and largest estimated error over the true one of the chosen configuration,
           where the reference is ten times as accurate as that one
refused    regular motions that ended with "accuracy is not reached", or that solvers cannot do
fallen     motions without an end, and how many of them ended with an error or a warning
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

import cosim
from casadi_models.dae import Dae, Start
from cosim.cli.tables import show_table
from cosim.errors import CosimError, SolverError
from cosim.scene.scene import Scene

MODELS = (
    *("crank_shaft", "bar_on_frame", "bicycle", "disk_two_bars", "double_pendulum"),
    *("bar_on_frame/two_body", "bicycle/multipliers", "double_pendulum/multipliers"),
)
ACCURACIES = (1e-3, 1e-6, 1e-9)


@dataclass
class Tally:
    """What became of the runs of one model at one accuracy; ratios to what was asked for."""

    returned: list[float] = field(default_factory=list)
    chosen: list[float] = field(default_factory=list)
    estimates: list[float] = field(default_factory=list)
    refused: int = 0
    unjudged: int = 0
    fallen: int = 0
    told: int = 0

    def row(self, model: str, accuracy: float) -> dict[str, object]:
        low, high = min(self.estimates, default=None), max(self.estimates, default=None)
        return {
            "model": model,
            "accuracy": accuracy,
            "kept": _share(self.returned),
            "worst": max(self.returned, default=None),
            "chosen": _share(self.chosen),
            "worst chosen": max(self.chosen, default=None),
            "estimate": f"{low:.2g} ... {high:.2g}" if low and high else "",
            "refused": self.refused,
            "unjudged": self.unjudged,
            "fallen": f"{self.told} of {self.fallen} told" if self.fallen else "",
        }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("models", metavar="MODEL", nargs="*", default=MODELS)
    parser.add_argument("--samples", type=int, default=40, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rows = []
    for model in args.models:
        began, dae = perf_counter(), cosim.load(model)
        tallies = {accuracy: Tally() for accuracy in ACCURACIES}
        fallen = regular = 0
        for values in samples(dae, np.random.default_rng(args.seed)):
            if ends_well(dae, values):
                judge(dae, values, tallies)
                regular += 1
            elif fallen < args.samples // 4:
                watch(dae, values, tallies)
                fallen += 1
            if regular == args.samples:
                break
        rows += [tally.row(dae.full_name, accuracy) for accuracy, tally in tallies.items()]
        print(f"{dae.full_name}: {perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
    show_table(rows, as_json=False)


def samples(dae: Dae, rng: np.random.Generator) -> Iterator[dict[str, float]]:
    """Yield values of all parameters and starts that the model accepts."""
    while True:
        values = {}
        for v in (*dae.parameters, *dae.states):
            if v.start is not None and v.start_kind is Start.EXACT:
                value = v.start * 2 ** rng.uniform(-1, 1)
                if v in dae.states:
                    value += 0.5 * v.nominal * rng.uniform(-1, 1)
                values[v.name] = float(np.clip(value, v.minimum, v.maximum))
        try:
            cosim.simulate(dae, start=values, stop_time=0.0)
        except CosimError:
            continue  # no such body, or no such start
        yield values


def ends_well(dae: Dae, values: dict[str, float]) -> bool:
    """Tell whether a motion stays within the model's limits, and is finite."""
    try:
        cosim.simulate(dae, start=values, on_invalid="stop")
    except SolverError:
        return False
    return True


def judge(dae: Dae, values: dict[str, float], tallies: dict[float, Tally]) -> None:
    """Run a sample at each accuracy, and compare with its reference."""
    try:
        best = cosim.reference(Scene(dae.full_name, dae, values=values))
    except SolverError:
        best = None
    for accuracy, tally in tallies.items():
        try:
            run = cosim.simulate(dae, start=values, accuracy=accuracy)
        except SolverError:
            tally.refused += 1
            continue
        if best is None or best.error(dae.observed) > accuracy / 10:
            tally.unjudged += 1
            continue
        solver, _, tolerance = run.stats["configuration"].partition(" at ")
        settings = {"solver": solver, "relative_tolerance": float(tolerance)}
        again = cosim.simulate(dae, start=values, **settings)
        truth = best.run.select(dae.observed)
        error = cosim.compare(truth, again).worst.scaled
        tally.returned.append(cosim.compare(truth, run).worst.scaled / accuracy)
        tally.chosen.append(error / accuracy)
        if best.error(dae.observed) <= error / 10:
            tally.estimates.append(run.stats["error_estimate"] / error)


def watch(dae: Dae, values: dict[str, float], tallies: dict[float, Tally]) -> None:
    """Run a sample without an end at each accuracy: it must not pass for a result."""
    for accuracy, tally in tallies.items():
        tally.fallen += 1
        try:
            tally.told += "invalid" in cosim.simulate(dae, start=values, accuracy=accuracy).stats
        except SolverError:
            tally.told += 1


def _share(ratios: list[float]) -> str:
    return f"{sum(ratio <= 1 for ratio in ratios)} of {len(ratios)}"


if __name__ == "__main__":
    main()
