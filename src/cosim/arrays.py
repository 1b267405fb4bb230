"""Types of arrays."""

import numpy as np
from numpy.typing import NDArray

Truths = NDArray[np.bool_]
Vector = NDArray[np.float64]  # of any number of dimensions; docstrings give the shape
