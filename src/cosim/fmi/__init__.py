"""FMU simulation: models as FMUs, and FMUs from anywhere."""
