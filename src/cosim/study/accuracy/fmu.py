"""An FMU whose default tolerance gives its outputs the accuracy that a user asks for.

The FMU itself is measured, run by fmpy over its default experiment at one tolerance after the
other, against the reference of the model. What is written is run once more, as an importer runs it
who gives no tolerance.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from casadi_models.dae import Dae
from cosim.errors import ExportError, FmuError, ParameterError
from cosim.files import refuse_unwritable, write_atomically
from cosim.fmi.export.package import export_fmu
from cosim.fmi.platforms import NATIVE
from cosim.fmi.run.instance import INTERFACES
from cosim.fmi.run.simulate import simulate_fmu
from cosim.host.temporary import temporary_folder
from cosim.study.accuracy.front import FRONT_TOLERANCES
from cosim.study.accuracy.solver_selection import SAFETY
from cosim.verify.comparison import Difference, compare
from cosim.verify.reference import Reference, reference
from cosim.verify.reference_result import export_with_proof

_CO_SIMULATION = "CoSimulation"


@dataclass(frozen=True)
class AccurateFmu:
    """An FMU with the tolerance that it recommends, and the errors that it has with it.

    Attributes:
        path: The file.
        accuracy: What was asked for, in nominal values.
        tolerance: Relative; of the default experiment.
        errors: The largest one, by interface; none where fmpy's solver gave up.
        reference: How that was computed which they are errors from.
    """

    path: Path
    accuracy: float
    tolerance: float
    errors: Mapping[str, Difference]
    reference: str

    def __str__(self) -> str:
        errors = ", ".join(
            f"{interface} {worst.scaled:.1e} ({worst.name})"
            for interface, worst in self.errors.items()
        )
        missed = [i for i in INTERFACES if i not in self.errors or self._misses(i)]
        warning = f"; not within it: {', '.join(missed)} through fmpy" if missed else ""
        return (
            f"accuracy {self.accuracy:g}: tolerance {self.tolerance:g}, error from "
            f"{self.reference}: {errors}{warning}"
        )

    def _misses(self, interface: str) -> bool:
        return self.errors[interface].scaled > self.accuracy


def export_accurate(
    dae: Dae, target: str | os.PathLike[str], accuracy: float, **options: Any
) -> AccurateFmu:
    """Export an FMU, with its proof, whose co-simulation meets an accuracy by default.

    The tolerance is the loosest one with which model exchange through fmpy meets it, too, or
    co-simulation alone where no tolerance lets the other.

    Args:
        dae: The model; its own values and span are what the promise is for.
        target: The file, replaced when everything has succeeded.
        accuracy: Largest global error of the outputs, in nominal values.
        options: See `export_fmu`; not its tolerance.

    Raises:
        ParameterError: No tolerance is tight enough.
        ExportError: What was written does not keep the promise.
        CosimError: See `export_with_proof`.
    """
    refuse_unwritable(target)
    best = reference(dae)
    here = options | {"platforms": (NATIVE,)}
    with temporary_folder() as folder:
        probe = export_fmu(dae, Path(folder) / "probe.fmu", **here)
        tolerance = _loosest(dae, probe, best, accuracy)
        final = export_with_proof(dae, Path(folder) / "final.fmu", tolerance=tolerance, **options)
        local = final
        if tuple(options.get("platforms", (NATIVE,))) != (NATIVE,):
            local = export_fmu(dae, Path(folder) / "local.fmu", tolerance=tolerance, **here)
        errors = {i: e for i in INTERFACES if (e := _fmu_error(local, best, i)) is not None}
        written = errors.get(_CO_SIMULATION)
        if written is None or written.scaled > accuracy:
            raise ExportError(
                f"{target} is not written: at tolerance {tolerance:g} its error is "
                f"{written.scaled if written else float('nan'):.1e}, not {accuracy:g}"
            )
        path = write_atomically(target, final.read_bytes())
    return AccurateFmu(path, accuracy, tolerance, errors, best.method)


def _loosest(dae: Dae, path: Path, best: Reference, accuracy: float) -> float:
    """Return the loosest tolerance that will do for both interfaces, or else for co-simulation."""
    enough: float | None = None
    least = float("inf")
    unknown = best.error(dae.observed)
    for tolerance in FRONT_TOLERANCES:
        if tolerance < 1e-13:  # which no FMU recommends
            break
        if enough is None:
            worst = _fmu_error(path, best, _CO_SIMULATION, tolerance)
            error = max(worst.scaled, unknown) if worst else float("inf")
            least = min(least, error)
            enough = tolerance if error * SAFETY <= accuracy else None
        if enough is not None:
            worst = _fmu_error(path, best, "ModelExchange", tolerance)
            if worst and worst.scaled * SAFETY <= accuracy:
                return tolerance
    if enough is None:
        raise ParameterError(
            f"{dae.full_name}: accuracy = {accuracy:g}; the FMU's own solver reaches "
            f"{1.1 * SAFETY * least:.1e} with a margin; ask for that, or for other outputs"
        )
    return enough


def _fmu_error(
    path: Path, best: Reference, interface: str, tolerance: float | None = None
) -> Difference | None:
    """Return the largest error of an FMU's outputs; None where its run fails."""
    try:
        run = simulate_fmu(path, interface=interface, relative_tolerance=tolerance)
    except FmuError:
        return None
    return compare(best.run, run).worst
