"""Rigid-body systems as symbolic DAEs: CVODES and IDAS on one road, FMUs on the other."""
