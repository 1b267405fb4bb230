"""Many runs of one model, scene or FMU: samples in, numbers, statistics and trajectories out."""
