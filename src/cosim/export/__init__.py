"""Export of a Dae as a Functional Mock-up Unit."""
