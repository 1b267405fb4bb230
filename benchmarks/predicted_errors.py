"""Reliability of `accuracy`: true errors for random parameters and initial values of every system.

    python benchmarks/predicted_errors.py [--samples 40] [--seed 1] [MODEL ...]

Each parameter and initial value is multiplied by a factor between 1/2 and 2, uniform in its
logarithm; an initial value is also shifted by up to half a nominal value. Samples that the model
rejects are drawn again. A motion that violates a validity condition or cannot be completed, such as
a bicycle that falls over, is counted separately: its error cannot be predicted, and its run must
end with an error or a warning.

The true error is the difference from `cosim.reference` of the sample: of several methods at their
tightest tolerance, the one that agrees best with another. If the error of the reference exceeds a
tenth of the requested accuracy, the sample is not compared.

within         returned runs whose true error is at most the requested accuracy
worst          largest of these errors, divided by the requested accuracy
chosen within, chosen worst
               the same for the cheapest configuration, which is run once more alone
estimate       smallest and largest estimated error of the chosen configuration, divided by its true
               error, if the reference is ten times as accurate as that configuration
not reached    regular motions for which no two runs agree, or the solvers fail
not compared   regular motions whose reference is not accurate enough
invalid        motions without a valid end, and how many of them ended with an error or a warning
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

MODELS = (
    *("crank_shaft", "bar_on_frame", "bicycle", "disk_two_bars", "double_pendulum"),
    *("bar_on_frame/two_body", "bicycle/multipliers", "double_pendulum/multipliers"),
)
ACCURACIES = (1e-3, 1e-6, 1e-9)


@dataclass
class Tally:
    """Results for one model at one accuracy; errors are divided by that accuracy."""

    returned: list[float] = field(default_factory=list)
    chosen: list[float] = field(default_factory=list)
    estimates: list[float] = field(default_factory=list)
    not_reached: int = 0
    not_compared: int = 0
    invalid: int = 0
    reported: int = 0

    def row(self, model: str, accuracy: float) -> dict[str, object]:
        low, high = min(self.estimates, default=None), max(self.estimates, default=None)
        return {
            "model": model,
            "accuracy": accuracy,
            "within": _share(self.returned),
            "worst": max(self.returned, default=None),
            "chosen within": _share(self.chosen),
            "chosen worst": max(self.chosen, default=None),
            "estimate": f"{low:.2g} ... {high:.2g}" if low and high else "",
            "not reached": self.not_reached,
            "not compared": self.not_compared,
            "invalid": f"{self.reported} of {self.invalid} reported" if self.invalid else "",
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
        invalid = regular = 0
        for values in samples(dae, np.random.default_rng(args.seed)):
            if stays_valid(dae, values):
                compare(dae, values, tallies)
                regular += 1
            elif invalid < args.samples // 4:
                count_reports(dae, values, tallies)
                invalid += 1
            if regular == args.samples:
                break
        rows += [tally.row(dae.full_name, accuracy) for accuracy, tally in tallies.items()]
        print(f"{dae.full_name}: {perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
    show_table(rows, as_json=False)


def samples(dae: Dae, rng: np.random.Generator) -> Iterator[dict[str, float]]:
    """Yield random values of all parameters and initial values that the model accepts."""
    while True:
        values = {}
        for v in (*dae.parameters, *dae.states):
            if v.start is not None and v.start_kind is Start.EXACT:
                value = v.start * 2 ** rng.uniform(-1, 1)
                if v in dae.states:
                    value += 0.5 * v.nominal * rng.uniform(-1, 1)
                values[v.name] = float(np.clip(value, v.minimum, v.maximum))
        try:
            cosim.simulate(dae, start_values=values, stop_time=0.0)
        except CosimError:
            continue  # no such body, or no consistent initial state
        yield values


def stays_valid(dae: Dae, values: dict[str, float]) -> bool:
    """Return whether a motion is finite and within the model's validity conditions."""
    try:
        cosim.simulate(dae, start_values=values, on_invalid="stop")
    except SolverError:
        return False
    return True


def compare(dae: Dae, values: dict[str, float], tallies: dict[float, Tally]) -> None:
    """Run a sample at each accuracy, and compare it with its reference."""
    try:
        best = cosim.reference(cosim.requested(dae, start_values=values))
    except SolverError:
        best = None
    for accuracy, tally in tallies.items():
        try:
            run = cosim.simulate(dae, start_values=values, accuracy=accuracy)
        except SolverError:
            tally.not_reached += 1
            continue
        if best is None or best.error(dae.observed) > accuracy / 10:
            tally.not_compared += 1
            continue
        solver, _, tolerance = run.stats["configuration"].partition(" at ")
        settings = {"solver": solver, "relative_tolerance": float(tolerance)}
        again = cosim.simulate(dae, start_values=values, **settings)
        truth = best.run.select(dae.observed)
        error = cosim.compare(truth, again).worst.scaled
        tally.returned.append(cosim.compare(truth, run).worst.scaled / accuracy)
        tally.chosen.append(error / accuracy)
        if best.error(dae.observed) <= error / 10:
            tally.estimates.append(run.stats["error_estimate"] / error)


def count_reports(dae: Dae, values: dict[str, float], tallies: dict[float, Tally]) -> None:
    """Run a sample without a valid end at each accuracy: an error or a warning must report it."""
    for accuracy, tally in tallies.items():
        tally.invalid += 1
        try:
            tally.reported += (
                "invalid" in cosim.simulate(dae, start_values=values, accuracy=accuracy).stats
            )
        except SolverError:
            tally.reported += 1


def _share(ratios: list[float]) -> str:
    return f"{sum(ratio <= 1 for ratio in ratios)} of {len(ratios)}"


if __name__ == "__main__":
    main()
