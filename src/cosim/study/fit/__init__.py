"""Fit of parameters and initial values to measurements."""
