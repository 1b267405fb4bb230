"""A name, a file or a CasADi object to a `Dae`, and the numbers that users give to it."""
