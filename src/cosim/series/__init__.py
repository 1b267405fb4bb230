"""Samples over time: what is known of a column, other times, CSV files."""
