"""Runs that move."""
