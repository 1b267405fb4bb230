"""Many variants of a model at once."""
