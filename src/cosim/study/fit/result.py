"""`Fit`: values, their confidence, and what the measurements cannot identify."""

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from casadi_models import CATALOG
from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import UsageError, naming_arguments_of
from cosim.files import write_atomically
from cosim.integrate.keywords import requested
from cosim.model.values import whole
from cosim.study.fit.subject import ModelSubject, Subject
from cosim.text import counted, html_table, text_table
from cosim.trajectory import Column, Trajectory
from cosim.verify.comparison import Comparison, compare, plot_comparisons


@naming_arguments_of
@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters and initial values that fit measurements best.

    Attributes:
        columns: The fitted variables: name, unit, meaning.
        x: Their values, SI, (n,).
        covariance: Covariance of the values, (n, n); infinite for what is not identified, NaN for
            a value that ends at its bound, with which those of the others hold.
        confidence: Probability that an interval contains the value.
        reach: Half an interval in standard errors.
        rank: Number of combinations of the values that the measurements identify.
        unidentified: Sentences on what they do not identify.
        notes: Sentences on the course of the fit, e.g. a value at its bound.
        noise: Standard deviation of the noise of each output, SI: given or estimated.
        samples: Number of measured values.
        start_values: Further values of the runs, by name.
        settled: All values of the run of the first record, by name in the model.
        records: The measurements.
        runs: Run with the fitted values for each record.
        subject: The model.

    Example:
        >>> import cosim
        >>> record = cosim.simulate("crank_shaft", stop_time=1, outputs=["phi"])
        >>> cosim.fit("crank_shaft", record, {"alpha": (1.0, 50.0)}).rank
        1
    """

    columns: tuple[Column, ...]
    x: Vector
    covariance: Vector
    confidence: float
    reach: float
    rank: int
    unidentified: tuple[str, ...]
    notes: tuple[str, ...]
    noise: Mapping[str, float]
    samples: int
    start_values: Mapping[str, float]
    settled: Mapping[str, float]
    records: tuple[Trajectory, ...]
    runs: tuple[Trajectory, ...]
    subject: Subject

    @property
    def values(self) -> dict[str, float]:
        """The fitted values by name, SI."""
        return {c.name: float(value) for c, value in zip(self.columns, self.x, strict=True)}

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors of the values by name, SI."""
        sizes = np.sqrt(np.diag(self.covariance))
        return {c.name: float(size) for c, size in zip(self.columns, sizes, strict=True)}

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Confidence intervals by name, SI."""
        pairs = ((name, self.values[name], self.reach * size) for name, size in self.errors.items())
        return {name: (value - half, value + half) for name, value, half in pairs}

    @property
    def correlation(self) -> Vector:
        """Correlation of the values, (n, n); NaN for what is not identified or at its bound."""
        sizes = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            found: Vector = self.covariance / sizes / sizes[:, None]
        return found

    @property
    def dae(self) -> Dae:
        """The model with the values of the first record, e.g. for `export_fmu`.

        Raises:
            UsageError: An FMU was fitted.
        """
        return requested(self._model, start_values=self.settled).configured()

    @property
    def _model(self) -> Dae:
        if not isinstance(self.subject, ModelSubject):
            raise UsageError(f"{self.subject.name}: an FMU was fitted; there is no model of it")
        return self.subject.dae

    def compare(self, record: int = 0, *, bound: float = 0.05) -> Comparison:
        """Compare the fitted run with a record; see `cosim.compare`."""
        whole("fit", "record", record, 0, len(self.records) - 1)
        return compare(self.runs[record], self.records[record], bound=bound)

    def plot(self, target: str | os.PathLike[str] | None = None, record: int | None = None) -> Any:
        """Draw the fitted runs, the measurements and the residuals; see `Comparison.plot`.

        Args:
            target: PNG, SVG or PDF file; no file if None.
            record: Number of a record, from 0; all records side by side if None.

        Returns:
            The figure of matplotlib.
        """
        chosen = range(len(self.records)) if record is None else [record]
        return plot_comparisons([self.compare(number) for number in chosen], target)

    def scene(self, model: str = "", folder: str | os.PathLike[str] = ".") -> str:
        """Return a scene with the values of the first record, as the text of a TOML file.

        Args:
            model: MODEL or PATH.py:FUNCTION; what `fit` was given when empty.
            folder: Where the scene will be, from which it finds PATH.

        Raises:
            UsageError: An FMU was fitted, or a `Dae` that no name stands for.
        """
        dae = self._model
        reference = model or getattr(self.subject, "reference", "")
        if not (reference or dae.full_name in CATALOG):
            raise UsageError(
                f"{dae.full_name}: a scene names its model; give model='PATH.py:FUNCTION', or "
                "export the model with its fitted values as an FMU"
            )
        path, colon, function = reference.rpartition(".py:")
        if colon:
            own = Path(os.path.relpath(f"{path}.py", folder)).as_posix()
            reference = f"{own}:{function}"
        home = {v.name: "parameters" for v in dae.parameters}
        home |= {v.name: "inputs" for v in dae.inputs}
        lines = [f"model = {_quoted(reference or dae.full_name)}"]
        for section in ("parameters", "start", "inputs"):
            chosen = {n: v for n, v in self.settled.items() if home.get(n, "start") == section}
            keys = (n if re.fullmatch(r"[A-Za-z0-9_-]+", n) else _quoted(n) for n in chosen)
            rows = [f"{n} = {float(v)!r}" for n, v in zip(keys, chosen.values(), strict=True)]
            lines += ["", f"[{section}]", *rows] if rows else []
        return "\n".join(lines) + "\n"

    def write_scene(self, target: str | os.PathLike[str], model: str = "") -> None:
        """Write the scene with the fitted values to a TOML file; `model` as in `scene`.

        Raises:
            UsageError: As for `scene`.
            ExportError: The file cannot be written.
        """
        write_atomically(target, self.scene(model, Path(target).parent).encode())

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each value, in display units."""
        found = []
        for column, value in zip(self.columns, self.x, strict=True):
            low, high = self.intervals[column.name]
            shown, low, high = map(float, column.shown(np.array([value, low, high])))
            error = float(column.shown(np.array(self.errors[column.name]), difference=True))
            known = not np.isnan(error)  # a value at its bound has no error
            found.append(
                {
                    "name": column.name,
                    "value": f"{shown:.6g}",
                    "error": error if known else None,
                    f"{self.confidence:.3g} from": f"{low:.6g}" if known else None,
                    "to": f"{high:.6g}" if known else None,
                    "unit": column.shown_unit,
                }
            )
        return found

    def __str__(self) -> str:
        noise = ", ".join(
            f"{name} {column.shown(np.array(size), difference=True):.3g} {column.shown_unit}"
            for name, size in self.noise.items()
            for column in [next(run for run in self.runs if name in run).column(name)]
        )
        fitted = f"{counted(len(self.x), 'value')} fitted to {self.samples} measured ones"
        return f"{self.subject.name}: {fitted}; residuals (standard deviation): {noise}"

    def __repr__(self) -> str:
        return "\n".join([str(self), text_table(self.rows()), *self.unidentified, *self.notes])

    def _repr_html_(self) -> str:
        return html_table(self.rows(), str(self))


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # TOML knows no pairs of surrogates
