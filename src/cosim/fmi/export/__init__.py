"""From a `Dae` to an FMU."""
