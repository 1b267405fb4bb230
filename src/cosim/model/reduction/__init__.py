"""What a scene requires of a model, and nothing more."""
