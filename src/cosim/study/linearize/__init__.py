"""The linear system near a state: matrices, eigenvalues, and where they cross."""
