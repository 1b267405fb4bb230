"""Solvers by family: a new one is a file here and a line in the table `integrate.solvers`."""
