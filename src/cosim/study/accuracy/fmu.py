"""Export of an FMU whose default tolerance gives a requested accuracy.

fmpy runs the FMU over its default experiment at one tolerance after another, and the results are
compared with the model's reference. The final FMU is checked once more, with its default tolerance.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

from casadi_models.dae import Dae
from cosim.errors import ExportError, FmuError, ParameterError
from cosim.files import reject_unwritable, write_atomically
from cosim.fmi.export.package import FmuKeywords, export_fmu
from cosim.fmi.platforms import NATIVE
from cosim.fmi.run.instance import INTERFACES
from cosim.fmi.run.simulate import simulate_fmu
from cosim.host.temporary import temporary_folder
from cosim.study.accuracy.candidates import TOLERANCES
from cosim.study.accuracy.choice import SAFETY
from cosim.verify.comparison import Difference, compare
from cosim.verify.reference import Reference, reference
from cosim.verify.reference_result import export_with_reference

_CO_SIMULATION = "CoSimulation"


@dataclass(frozen=True)
class AccurateFmu:
    """An FMU with its recommended tolerance, and its errors at that tolerance.

    Attributes:
        path: The file.
        accuracy: Requested accuracy, in nominal values.
        tolerance: Relative tolerance of the default experiment.
        errors: The largest error by interface; missing where fmpy's solver failed.
        reference: Method that computed the reference.
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
        met = [i for i, worst in self.errors.items() if worst.scaled <= self.accuracy]
        missed = [i for i in INTERFACES if i not in met]
        warning = f"; not within it: {', '.join(missed)} through fmpy" if missed else ""
        return (
            f"accuracy {self.accuracy:g}: tolerance {self.tolerance:g}, error from "
            f"{self.reference}: {errors}{warning}"
        )


def export_accurate(
    dae: Dae, target: str | os.PathLike[str], accuracy: float, **options: Unpack[FmuKeywords]
) -> AccurateFmu:
    """Export an FMU with a reference result whose co-simulation meets an accuracy by default.

    The tolerance is the loosest one at which co-simulation and model exchange through fmpy meet
    the accuracy; if model exchange meets it at no tolerance, co-simulation alone decides.

    Args:
        dae: The model; the accuracy holds for its own values and its default experiment.
        target: The file, replaced when everything has succeeded.
        accuracy: Largest global error of the outputs, in nominal values.
        options: See `export_fmu`, without `tolerance`.

    Raises:
        ParameterError: No tolerance is tight enough.
        ExportError: The exported FMU misses the accuracy.
        CosimError: See `export_with_reference`.
    """
    reject_unwritable(target)
    best = reference(dae)
    here: FmuKeywords = {**options, "platforms": (NATIVE,)}
    with temporary_folder() as folder:
        probe = export_fmu(dae, Path(folder) / "probe.fmu", **here)
        tolerance = _loosest(dae, probe, best, accuracy)
        options["tolerance"] = here["tolerance"] = tolerance
        final = export_with_reference(dae, Path(folder) / "final.fmu", **options)
        local = final
        if tuple(options.get("platforms", (NATIVE,))) != (NATIVE,):
            local = export_fmu(dae, Path(folder) / "local.fmu", **here)
        found = {str(i): _fmu_error(local, best, i) for i in INTERFACES}
        errors = {name: error for name, error in found.items() if error is not None}
        written = errors.get(_CO_SIMULATION)
        if written is None or written.scaled > accuracy:
            raise ExportError(
                f"{target} is not written: at tolerance {tolerance:g} its error is "
                f"{written.scaled if written else float('nan'):.1e}, not {accuracy:g}"
            )
        path = write_atomically(target, final.read_bytes())
    return AccurateFmu(path, accuracy, tolerance, errors, best.method)


def _loosest(dae: Dae, path: Path, best: Reference, accuracy: float) -> float:
    """Return the loosest sufficient tolerance for both interfaces, or else for co-simulation."""
    enough: float | None = None
    least = float("inf")
    unknown = best.error(dae.observed)
    for tolerance in TOLERANCES:
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
            f"{1.1 * SAFETY * least:.1e} with a margin; request that, or other outputs"
        )
    return enough


def _fmu_error(
    path: Path, best: Reference, interface: str, tolerance: float | None = None
) -> Difference | None:
    """Return the largest error of an FMU's outputs; None if its run fails."""
    try:
        run = simulate_fmu(path, interface=interface, relative_tolerance=tolerance)
    except FmuError:
        return None
    return compare(best.run, run).worst
