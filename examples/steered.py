"""A controller as a plain Python function keeps the bicycle upright at 3.5 m/s, where it falls."""

import numpy as np

import cosim

MEASURED = ["phi", "delta", "phi_dot", "delta_dot"]
GAINS = np.array([[-22.88, 18.26, -5.68, 1.75], [10.08, -6.73, 2.73, -0.63]])  # as in rider.py
START = {"speed": "3.5 m/s", "phi_dot": 0.2}


def rider(measured):
    """Return the torques on steer and roll axis, N.m, for roll and steer angle and their rates."""
    return np.clip(-GAINS @ measured, -10.0, 10.0)


def ride(controller, seconds=5.0, every=0.01):
    """Return times and roll angles of a ride whose torques a function chooses every 10 ms."""
    rows = []
    with cosim.open("bicycle", start_values=START) as bike:
        while bike.time < seconds:
            steer, roll = controller(bike.get(MEASURED)).tolist()
            bike.set(steer_torque=steer, roll_torque=roll)
            bike.advance(every)
            rows.append((bike.time, bike["phi"]))
    return np.array(rows)


if __name__ == "__main__":
    for name, controller in (("rider", rider), ("nobody", lambda _: np.zeros(2))):
        times, angles = ride(controller, seconds=2.0).T
        print(f"{name}: {np.degrees(angles[-1]):.3f} deg at {times[-1]:g} s")
