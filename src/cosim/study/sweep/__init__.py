"""Sweeps: many runs of one model, scene or FMU, with their numbers and statistics."""
