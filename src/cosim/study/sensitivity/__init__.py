"""Sensitivity analysis: derivatives of a run by parameters, initial values and inputs."""
