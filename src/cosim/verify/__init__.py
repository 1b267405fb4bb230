"""Comparison of runs, reference results and crosschecks of all backends."""
