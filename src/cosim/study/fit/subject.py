"""`Subject`: a model or an FMU whose outputs are fitted to measurements."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import SolverError, UnknownName
from cosim.fmi.run.description import by_name
from cosim.fmi.run.opened import still_open
from cosim.fmi.run.request import column_of
from cosim.fmi.run.simulate import simulate_fmu
from cosim.fmi.run.typed_values import bounds_of
from cosim.integrate.keywords import requested
from cosim.integrate.run import run
from cosim.model.catalogue import loaded
from cosim.model.reduction import checked_outputs
from cosim.model.values import settable_variable
from cosim.study.sensitivity.sensitivity import sensitivity
from cosim.trajectory import Column, Trajectory

STEP = 1e-4  # step of finite differences, relative to the size of an unknown


@dataclass(frozen=True)
class Known:
    """What a model declares of a value that may be fitted; SI, or the units of an FMU.

    `start` is NaN where it is calculated.
    """

    column: Column
    start: float
    minimum: float
    maximum: float


@dataclass(frozen=True)
class ModelSubject:
    """A model; its derivatives are those of the variational equations, events included.

    `reference` is what it was loaded by: MODEL or PATH.py:FUNCTION; empty if that is unknown.
    """

    dae: Dae
    settings: Mapping[str, Any]
    reference: str = ""
    derivatives: ClassVar[str] = "variational equations"  # how they are computed

    @property
    def name(self) -> str:
        """Name of the model."""
        return self.dae.full_name

    def known(self, name: str) -> Known:
        """Return what is declared of a parameter, a start value or a constant input."""
        v = settable_variable(self.dae, name)
        column = Column(v.name, v.unit, v.display_unit, v.nominal, v.meaning)
        start = np.nan if v.start is None else float(v.start)
        return Known(column, start, v.minimum, v.maximum)

    def column(self, name: str) -> Column:
        """Return the variable of an output."""
        checked_outputs(self.dae, [name])
        v = self.dae.watching([name]).variable(name)
        return Column(v.name, v.unit, v.display_unit, v.nominal, v.meaning)

    def run(self, values: Mapping[str, float], names: Sequence[str], times: Vector) -> Trajectory:
        """Return the run with some values at measured times, s."""
        keywords = {"outputs": names, "output_times": times, **self.settings}
        return run(requested(self.dae, start_values=values, **keywords))

    def slopes(
        self, values: Mapping[str, float], by: Sequence[str], names: Sequence[str], times: Vector
    ) -> Vector:
        """Return the derivatives of outputs by unknowns, (n, outputs, unknowns)."""
        found = sensitivity(
            self.dae,
            outputs=names,
            with_respect_to=by,
            start_values=values,
            output_times=times,
            check=False,
            **self.settings,
        )
        if len(found.values) < len(times):
            raise SolverError(f"{self.name}: the run stops before the last measurement")
        return found.values


@dataclass(frozen=True)
class FmuSubject:
    """An FMU; its derivatives are finite differences of its runs."""

    path: str
    settings: Mapping[str, Any]
    derivatives: ClassVar[str] = "finite differences of runs of the FMU"

    @property
    def name(self) -> str:
        """Path of the FMU."""
        return self.path

    @property
    def _description(self) -> Any:
        return still_open(self.path, None).description

    def _variable(self, name: str) -> Any:
        variables = by_name(self._description)
        UnknownName.reject(self.path, "variable", variables, name)
        return variables[name]

    def known(self, name: str) -> Known:
        """Return what is declared of a parameter, a start value or a constant input."""
        variable = self._variable(name)
        low, high = (
            other if text is None else float(text)
            for text, other in zip(bounds_of(variable), (-np.inf, np.inf), strict=True)
        )
        return Known(self.column(name), float(variable.start or 0.0), low, high)

    def column(self, name: str) -> Column:
        """Return the variable of an output."""
        return column_of(self._variable(name), self._description)

    def run(self, values: Mapping[str, float], names: Sequence[str], times: Vector) -> Trajectory:
        """Return the run with some values at measured times, s."""
        stop, gaps = float(times[-1]), np.diff(times) if len(times) > 1 else times
        found = simulate_fmu(
            self.path,
            start_values=values,
            start_time=0.0,
            stop_time=stop,
            output_interval=min(stop / 500, float(np.median(gaps))),
            outputs=names,
            **self.settings,
        )
        sampled: Trajectory = found.at(times)
        return sampled

    def slopes(
        self, values: Mapping[str, float], by: Sequence[str], names: Sequence[str], times: Vector
    ) -> Vector:
        """Return the derivatives of outputs by unknowns, (n, outputs, unknowns)."""
        columns = []
        for name in by:
            known = self.known(name)
            step = STEP * max(abs(values[name]), STEP * (abs(known.start) or known.column.nominal))
            ends = np.clip((values[name] - step, values[name] + step), known.minimum, known.maximum)
            low, high = (self.run({**values, name: end}, names, times).values for end in ends)
            columns.append((high - low) / np.diff(ends))
        return np.stack(columns, axis=-1)


Subject = ModelSubject | FmuSubject


def subject_of(model: Dae | str | os.PathLike[str], settings: Mapping[str, Any]) -> Subject:
    """Return what is fitted, from a model, its name, or the file of an FMU."""
    if isinstance(model, Dae):
        return ModelSubject(model, settings)
    if str(model).lower().endswith(".fmu"):
        return FmuSubject(str(model), settings)
    return ModelSubject(loaded(str(model)), settings, str(model))
