"""Error against cost."""
