"""What is wrong with an FMU."""
