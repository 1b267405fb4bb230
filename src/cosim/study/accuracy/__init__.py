"""Accuracy and budget: targets from which a solver and its tolerance are chosen."""
