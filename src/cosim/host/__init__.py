"""The machine below: processes, signals, terminals, temporary folders."""
