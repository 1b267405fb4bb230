"""Sessions: models that stay alive between calls of Python."""
