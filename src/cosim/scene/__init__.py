"""A model, numbers and wanted outputs, down any road."""
