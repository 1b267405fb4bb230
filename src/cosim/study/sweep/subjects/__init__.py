"""What is swept: a model, a scene or an FMU."""
