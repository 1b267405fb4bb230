"""Derivatives of a run with respect to parameters, start values and constant inputs."""
