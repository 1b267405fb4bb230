"""Input time series for an FMU under fmpy, at every time at which the FMU asks for them.

fmpy's own tables are not used between samples: in model exchange they freeze the inputs between
output points, and for co-simulation they cannot hand over slopes (fmpy 0.3.32 copies them into an
array of nine). So time and steps are intercepted, and fmpy learns of the samples as events only.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.model.inputs import InputSeries

InputValues = dict[str, float]
_SAME_EVENT = 1e-9  # of a time, with which fmpy compares events


def inputs_at_start(series: InputSeries, start_time: float) -> InputValues:
    """Return the inputs at the start by name, to be set before initialization ends."""
    at_start = series.at(np.array([start_time]))[:, 0]
    return dict(zip(series.names, map(float, at_start), strict=True))


def drive_model_exchange(
    instance: Any,
    series: InputSeries,
    references: Sequence[int],
    constants: InputValues,
    start_time: float,
) -> NDArray[Any]:
    """Make an FMU's inputs follow a series wherever its time is set; return fmpy's `input` array.

    Args:
        instance: fmpy's object for the FMU.
        series: The inputs over time.
        references: Value references of `series.names`.
        constants: All other inputs by name; fmpy complains on standard output of missing ones.
        start_time: s.

    Returns:
        The samples, each twice: fmpy restarts its solver at such times, so that it steps over no
        kink and no pulse.
    """
    set_time, begin_anew = instance.setTime, instance.enterContinuousTimeMode
    set_real, last, followed = _setter(instance), start_time, series.around(start_time)

    def set_time_and_inputs(time: float) -> None:
        nonlocal last
        last = time
        set_time(time)
        set_real(references, followed.at(np.array([time]))[:, 0].tolist())

    def follow_the_next_piece() -> None:
        nonlocal followed  # fmpy's solver looks beyond a jump, and then finds what was before it
        followed = series.around(last + _SAME_EVENT * abs(last))
        begin_anew()

    instance.setTime, instance.enterContinuousTimeMode = set_time_and_inputs, follow_the_next_piece
    start = inputs_at_start(series, start_time)
    names = ("time", *series.names, *constants)
    samples = np.empty(2 * len(series.time), dtype=[(name, np.float64) for name in names])
    samples["time"] = np.repeat(series.time, 2)
    for name, values in zip(series.names, series.values.T, strict=True):
        samples[name] = np.repeat(values, 2)
        samples[name][samples["time"] == start_time] = start[name]
    for name, value in constants.items():
        samples[name] = value
    return samples


def drive_co_simulation(
    instance: Any, series: InputSeries, references: Sequence[int], abilities: Any
) -> None:
    """Make an FMU's inputs follow a series within its steps, which end at every sample.

    An FMU that can interpolate gets the slope of each piece. Another one gets the value at the
    piece's middle, which leaves an error of second order in the step; of first order where inputs
    jump within the step of an FMU whose steps have one size.

    Args:
        instance: fmpy's object for the FMU.
        series: The inputs over time.
        references: Value references of `series.names`.
        abilities: fmpy's record of the FMU's co-simulation flags.
    """
    step, set_real = instance.doStep, _setter(instance)
    slopes: Callable[..., None] | None = getattr(instance, "setRealInputDerivatives", None)
    if not abilities.canInterpolateInputs:
        slopes = None

    def driven_step(begin: float, length: float) -> Any:
        times = np.unique(series.time)
        inner = (times > begin) & (times < begin + length)
        inner &= ~np.isclose(times, begin) & ~np.isclose(times, begin + length)
        if not abilities.canHandleVariableCommunicationStepSize:
            inner[:] = False
        result = None
        for a, b in pairwise([begin, *times[inner].tolist(), begin + length]):
            piece = series.around((a + b) / 2)
            first, middle, last = piece.at(np.array([a, (a + b) / 2, b])).T
            set_real(references, (first if slopes else middle).tolist())
            if slopes:
                slopes(references, [1] * len(references), ((last - first) / (b - a)).tolist())
            result = step(currentCommunicationPoint=a, communicationStepSize=b - a)
        following = series.around(b + _SAME_EVENT * abs(b))
        if not slopes or following is not piece:
            set_real(references, following.at(np.array([b]))[:, 0].tolist())
        return result

    instance.doStep = lambda currentCommunicationPoint, communicationStepSize: driven_step(
        currentCommunicationPoint, communicationStepSize
    )


def _setter(instance: Any) -> Callable[[Sequence[int], list[float]], None]:
    setter: Callable[[Sequence[int], list[float]], None]
    setter = instance.setReal if hasattr(instance, "setReal") else instance.setFloat64
    return setter
