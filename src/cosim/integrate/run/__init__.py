"""One run: the call of an engine, what is recorded of it, and where it stops."""
