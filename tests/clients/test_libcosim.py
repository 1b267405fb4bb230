import sys

import numpy as np
import pytest
from helpers.riding import SEEN, SPAN, STARTS, TORQUES, Pair

pytest.importorskip("libcosimpy", reason="libcosimpy has no wheel for this platform")


def ride(pair: Pair, step: float, *, coupled: bool = True) -> np.ndarray:
    """Return roll and steer at the end, computed by libcosim with a fixed macro step."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(step_size=round(step * 1e9))
    slaves = {
        name: CosimLocalSlave(fmu_path=str(getattr(pair, name)), instance_name=name)
        for name in ("bicycle", "rider")
    }
    index = {name: execution.add_local_slave(slave) for name, slave in slaves.items()}
    bike, mind = (pair.references[name] for name in ("bicycle", "rider"))
    for name, value in STARTS.items():
        execution.real_initial_value(index["bicycle"], bike[name], value)
    for name in SEEN:
        execution.connect_real_variables(index["bicycle"], bike[name], index["rider"], mind[name])
    for name in TORQUES if coupled else ():
        execution.connect_real_variables(index["rider"], mind[name], index["bicycle"], bike[name])
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    assert execution.simulate_until(target_time=round(SPAN * 1e9))
    return np.array(observer.last_real_values(index["bicycle"], [bike["phi"], bike["delta"]]))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="libcosim logs and paths are tested on Linux")
def test_rider_keeps_the_bicycle_up_where_it_falls_alone(pair):
    assert abs(ride(pair, 0.01)[0]) < 1e-3  # rad; measured 3e-4
    assert abs(ride(pair, 0.01, coupled=False)[0]) > 0.1  # growing; measured 0.18


@pytest.mark.slow
def test_error_of_the_coupling_is_first_order_in_the_macro_step(pair):
    errors = [np.abs(ride(pair, step) - pair.expected).max() for step in (0.008, 0.004, 0.002)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 1, atol=0.25)


@pytest.mark.slow
def test_extrapolated_macro_steps_meet_the_coupled_solution(pair):
    fine, coarse = ride(pair, 0.001), ride(pair, 0.002)
    extrapolated = 2 * fine - coarse
    np.testing.assert_allclose(extrapolated, pair.expected, rtol=0, atol=2e-5)
