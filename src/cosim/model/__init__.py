"""A name, a file of a user or an object of CasADi becomes a Dae and its numbers."""
