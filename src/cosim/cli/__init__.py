"""Command line: `cosim VERB ...`."""
