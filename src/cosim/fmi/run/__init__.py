"""Runs of FMUs through fmpy."""
