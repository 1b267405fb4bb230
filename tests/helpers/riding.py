"""The system that the clients couple: a bicycle at 3.5 m/s, which falls, and its rider."""

from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import cosim
from casadi_models.dae import Dae
from cosim.integrate.integrator import start_vectors

ROOT = Path(__file__).parents[2]
SEEN = ("phi", "delta", "phi_dot", "delta_dot")
TORQUES = ("steer_torque", "roll_torque")
STARTS = {"thetaR_dot": -3.5 / 0.3, "phi_dot": 0.2}
SPAN = 2.0  # s; the free bicycle has fallen after it


class Pair(NamedTuple):
    """FMUs, value references by name, and roll and steer at the end of the coupled motion."""

    bicycle: Path
    rider: Path
    references: dict[str, dict[str, int]]
    expected: NDArray[np.float64]


@pytest.fixture(scope="session")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    folder = tmp_path_factory.mktemp("ride")
    bicycle = cosim.reduce(cosim.load("bicycle"), SEEN)
    rider = cosim.load(f"{ROOT}/examples/rider.py:build")
    files = {
        "bicycle": cosim.export_fmu(bicycle, folder / "bicycle.fmu"),
        "rider": cosim.export_fmu(rider, folder / "rider.fmu"),
    }
    references = {name: _references(path) for name, path in files.items()}
    return Pair(files["bicycle"], files["rider"], references, _coupled(bicycle, rider))


def _references(path: Path) -> dict[str, int]:
    from fmpy import read_model_description

    variables = read_model_description(str(path)).modelVariables
    return {variable.name: variable.valueReference for variable in variables}


def _coupled(bicycle: Dae, rider: Dae) -> NDArray[np.float64]:
    """Integrate both as one system with scipy, without any communication step."""
    bike, mind = (ca.Function("f", [d.x, d.u, d.p], [d.ode, d.outputs]) for d in (bicycle, rider))
    bike_start, mind_start = start_vectors(bicycle, STARTS), start_vectors(rider)
    names = [v.name for v in bicycle.states]
    seen = [names.index(name) for name in SEEN]
    nx = len(names)

    def rates(_: float, x: NDArray[np.float64]) -> NDArray[np.float64]:
        effort, torques = mind(x[nx:], x[seen], mind_start["p"])
        motion, _outputs = bike(x[:nx], ca.vertcat(torques, 0), bike_start["p"])
        return np.concatenate((np.array(motion).ravel(), np.array(effort).ravel()))

    start = np.concatenate((bike_start["x0"], mind_start["x0"]))
    solution = solve_ivp(rates, (0, SPAN), start, method="DOP853", rtol=1e-10, atol=1e-12)
    return np.array(solution.y[seen[:2], -1])
