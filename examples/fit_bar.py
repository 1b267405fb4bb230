"""Fit the swinging bar to measured angles: values, confidence, and what they cannot identify."""

from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

import cosim

DAE = cosim.load("bar_on_frame/reduced")


def residuals(x, names, measured):
    """Return run minus measurement, (samples,)."""
    settings = {"outputs": measured.names, "output_times": measured.time}
    run = cosim.simulate(DAE, start_values=dict(zip(names, x, strict=True)), **settings)
    return (run.values - measured.values)[np.isfinite(measured.values)]  # without gaps


def slopes(x, names, measured):
    """Return the derivatives of the residuals by the values, (samples, values)."""
    settings = {"outputs": measured.names, "output_times": measured.time, "check": False}
    values = dict(zip(names, x, strict=True))
    found = cosim.sensitivity(DAE, with_respect_to=names, start_values=values, **settings)
    return found.values[np.isfinite(measured.values)]


def fit(measured, initial):
    """Return the values with the least squares of all residuals, and their covariance."""
    names, x = [*initial], [*initial.values()]
    bounds = np.transpose([(v.minimum, v.maximum) for v in map(DAE.variable, names)])
    options = {"bounds": bounds, "x_scale": "jac", "args": (names, measured)}
    found = least_squares(residuals, x, slopes, **options)
    variance = found.fun @ found.fun / (len(found.fun) - len(x))  # of the noise
    covariance = variance * np.linalg.inv(found.jac.T @ found.jac)
    return dict(zip(names, found.x.tolist(), strict=True)), covariance


def identifiable(measured, values):
    """Return how many combinations of relative changes of the values the samples identify."""
    x = np.array([*values.values()])
    scaled = slopes(x, [*values], measured) * x
    return int(np.linalg.matrix_rank(scaled, rtol=1e-6))


if __name__ == "__main__":
    columns = {"theta": "angle [deg]"}
    swing = cosim.Trajectory.read_csv("examples/bar_swing.csv", columns=columns, time="t [ms]")
    values, covariance = fit(swing, {"b": 0.02, "theta": 1.0, "theta_dot": 3.0})
    reach = student.ppf(0.975, len(swing) - swing.stats["gaps"] - len(values))
    for (name, value), own in zip(values.items(), np.sqrt(np.diag(covariance)), strict=True):
        print(f"{name} = {value:.5g} +- {reach * own:.2g}")
    print(identifiable(swing, {"b": values["b"], "m": 2.9, "length": 0.3}), "of b, m, length")

    run = cosim.simulate(DAE, start_values=values, stop_time=4.0, outputs=["theta"])
    compared = cosim.compare(run, swing, bound=0.05)  # five percent of the nominal value
    print(repr(compared))
    compared.plot("fit.png")
    scene = (
        'model = "bar_on_frame/reduced"\n[parameters]\nb = {b!r}\n'
        "[start]\ntheta = {theta!r}\ntheta_dot = {theta_dot!r}\n"
    )
    Path("fitted.toml").write_text(scene.format(**values))
    cosim.export_fmu(cosim.read_scene("fitted.toml").request.configured(), "fitted.fmu")
