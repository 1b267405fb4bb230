"""Extended Kalman filter: the bicycle's motion from a noisy measurement of its roll angle alone."""

import numpy as np

import cosim

NAMES = ["phi", "delta", "phi_dot", "delta_dot"]  # what is estimated
STEP, NOISE = 0.01, np.radians(1.0)  # s; rad, standard deviation of the measurement
START = {"phi_dot": 0.2}
DISTURBED = np.diag([1e-8, 1e-8, 1e-6, 1e-6])  # covariance that a step adds


def filtered(measured, bike):
    """Return estimates of the states, (n, 4), and their standard deviations, (n, 4)."""
    x, P = np.zeros(4), np.diag([0.1, 0.1, 0.5, 0.5]) ** 2
    C, estimates, deviations = np.eye(4)[:1], [], []
    kept = [bike.states.index(name) for name in NAMES]
    for angle in measured:
        K = P @ C.T / (C @ P @ C.T + NOISE**2)  # correct
        x = x + K[:, 0] * (angle - x[0])
        P = (np.eye(4) - K @ C) @ P
        estimates.append(x)
        deviations.append(np.sqrt(np.diag(P)))
        bike.reset(dict(zip(NAMES, x.tolist(), strict=True)))  # predict
        A = bike.linearize(["phi"]).A[np.ix_(kept, kept)] * STEP
        F = np.eye(4) + A + A @ A / 2
        bike.advance(STEP)
        x, P = bike.get(NAMES), F @ P @ F.T + DISTURBED
    return np.array(estimates), np.array(deviations)


if __name__ == "__main__":
    truth = cosim.simulate("bicycle", start_values=START, stop_time=5.0, outputs=NAMES)
    measured = truth["phi"] + np.random.default_rng(1).normal(0.0, NOISE, len(truth))
    with cosim.open("bicycle") as bike:
        estimates, deviations = filtered(measured, bike)
    errors = np.degrees(np.sqrt(np.mean((estimates - truth.values)[100:] ** 2, axis=0)))
    for name, error in zip(NAMES, errors, strict=True):
        print(f"{name}: {error:.2f}")
