"""An accuracy, or a time, instead of a solver and its tolerance."""
