"""Solvers by family; a new solver is a file here and a line in the table `integrate.solvers`."""
