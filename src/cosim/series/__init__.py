"""Samples over time: interpolation and CSV files."""
