"""Run against run."""
