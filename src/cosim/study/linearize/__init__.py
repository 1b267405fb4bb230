"""Linearization of models and FMUs: matrices, eigenvalues, stability along a parameter."""
