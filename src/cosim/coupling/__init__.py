"""Coupled systems: several models and FMUs as one model, or in co-simulation."""
