"""Models at their limits."""
