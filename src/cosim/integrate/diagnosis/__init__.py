"""What may be wrong with a run: limits of its model, steps that are too long, kinks, monitors."""
