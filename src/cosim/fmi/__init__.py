"""Road two: models as FMUs, and FMUs from anywhere."""
