"""Extreme cases: models with extreme values, each run measured against a reference."""
