"""Scenes: TOML files that name a model, its values, the outputs to compute and the figures."""
