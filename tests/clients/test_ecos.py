import numpy as np
import pytest
from helpers.riding import SEEN, SPAN, STARTS, TORQUES, Pair

import cosim.fmi.ssp

try:
    import ecospy
except (ImportError, OSError) as error:  # its library needs libtbb
    pytest.skip(f"ecospy cannot be loaded: {error}", allow_module_level=True)

CONNECTIONS = [
    *((f"bicycle.{name}", f"rider.{name}") for name in SEEN),
    *((f"rider.{name}", f"bicycle.{name}") for name in TORQUES),
]


def ride(pair: Pair, step: float) -> np.ndarray:
    """Return roll and steer at the end, computed by ecos with a fixed macro step."""
    structure = ecospy.EcosSimulationStructure()
    structure.add_model("bicycle", str(pair.bicycle))
    structure.add_model("rider", str(pair.rider))
    for source, sink in CONNECTIONS:
        structure.make_real_connection(source.replace(".", "::"), sink.replace(".", "::"))
    structure.add_parameter_set("start", {f"bicycle::{n}": v for n, v in STARTS.items()})
    with ecospy.EcosSimulation(structure=structure, step_size=step) as simulation:
        simulation.init(parameter_set="start")
        simulation.step_until(SPAN)
        values = [simulation.get_real(f"bicycle::{name}") for name in ("phi", "delta")]
        simulation.terminate()
    return np.array(values)


@pytest.mark.slow
def test_rider_keeps_the_bicycle_up_in_ecos(pair):
    fine, coarse = ride(pair, 0.001), ride(pair, 0.002)
    np.testing.assert_allclose(2 * fine - coarse, pair.expected, rtol=0, atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("parameter_files", [False, True])
def test_ecos_runs_the_pair_from_one_ssp_file(pair, tmp_path, parameter_files):
    path = cosim.fmi.ssp.write_ssp(
        tmp_path / "ride.ssp",
        {"bicycle": pair.bicycle, "rider": pair.rider},
        CONNECTIONS,
        values={f"bicycle.{name}": value for name, value in STARTS.items()},
        stop_time=SPAN,
        parameter_files=parameter_files,
    )
    with ecospy.EcosSimulation(ssp_path=str(path), step_size=0.001) as simulation:
        simulation.init(parameter_set="initialValues")
        simulation.step_until(SPAN)
        roll = simulation.get_real("bicycle::phi")
        simulation.terminate()
    assert roll == pytest.approx(ride(pair, 0.001)[0], abs=1e-12)
