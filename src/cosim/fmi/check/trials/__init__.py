"""Trials that run an FMU: one small function per rule, each on instances of its own."""
