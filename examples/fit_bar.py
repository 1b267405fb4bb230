"""Fit the swinging bar to measured angles: values, confidence, and what they cannot identify."""

from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

import cosim

DAE = cosim.load("bar_on_frame/reduced")


def slopes(measured, values):
    """Return the derivatives of the measured variables by the values, (samples, values)."""
    settings = {"outputs": measured.names, "output_times": measured.time, "check": False}
    found = cosim.sensitivity(DAE, with_respect_to=[*values], start_values=values, **settings)
    return found.values[np.isfinite(measured.values)]  # without gaps


def fit(measured, initial):
    """Return the values with the least squares of all residuals, and their covariance."""

    def named(x):
        return dict(zip(initial, map(float, x), strict=True))

    def residuals(x):
        settings = {"outputs": measured.names, "output_times": measured.time}
        run = cosim.simulate(DAE, start_values=named(x), **settings)
        return (run.values - measured.values)[np.isfinite(measured.values)]

    variables = [DAE.variable(name) for name in initial]
    found = least_squares(
        residuals,
        [*initial.values()],
        lambda x: slopes(measured, named(x)),
        bounds=([v.minimum for v in variables], [v.maximum for v in variables]),
        x_scale="jac",
    )
    variance = found.fun @ found.fun / (len(found.fun) - len(initial))  # of the noise
    return named(found.x), variance * np.linalg.inv(found.jac.T @ found.jac)


def identifiable(measured, values):
    """Return how many combinations of relative changes of the values the samples identify."""
    scaled = slopes(measured, values) * np.array([*values.values()])
    return int(np.linalg.matrix_rank(scaled, tol=1e-6 * np.linalg.norm(scaled)))


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
    lines = ["[start]", *(f"{name} = {values[name]!r}" for name in ("theta", "theta_dot"))]
    lines = [f'model = "{DAE.full_name}"', "[parameters]", f"b = {values['b']!r}", *lines]
    Path("fitted.toml").write_text("\n".join(lines) + "\n")
    cosim.export_fmu(cosim.read_scene("fitted.toml").request.configured(), "fitted.fmu")
