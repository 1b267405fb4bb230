"""Building a `Dae` from a name, a file or a CasADi object, and checking its values."""
