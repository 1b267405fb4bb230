"""Coefficients of DOP853, the explicit Runge-Kutta pair of order 8(5,3) with dense output.

Source  Dormand & Prince's method with the error estimators and the interpolant of order 7 of
        Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993,
        section II.10 and appendix (program DOP853). Stage 13 is the slope at the end of the step;
        stages 14 to 16 serve the interpolant only. dop853.json has them by stage.
"""

import json
from pathlib import Path

Row = tuple[tuple[int, float], ...]  # (stage, weight); other weights are 0

_TABLE = json.loads(Path(__file__).with_name("dop853.json").read_text())


def _row(weights: dict[str, float]) -> Row:
    return tuple((int(stage), weight) for stage, weight in weights.items())


NODES = tuple(_TABLE["nodes"])
A = tuple(map(_row, _TABLE["a"]))
B = _row(_TABLE["b"])
DENSE = tuple(map(_row, _TABLE["dense"]))  # beyond the cubic Hermite polynomial
ERROR_5 = _row(_TABLE["error_5"])  # difference to an embedded solution of order 5
# difference to an embedded solution of order 3, which has three stages
ERROR_3 = tuple((stage, weight - _TABLE["b_3"].get(str(stage), 0.0)) for stage, weight in B)
