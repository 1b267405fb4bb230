"""The C files inside an FMU, generated from the equations of its model."""
