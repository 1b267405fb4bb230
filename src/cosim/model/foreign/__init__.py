"""Import of CasADi objects as a `Dae`."""
