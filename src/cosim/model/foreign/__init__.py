"""Other people's CasADi objects to a `Dae`."""
