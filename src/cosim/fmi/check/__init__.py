"""The FMU checker: static checks and trials that run the FMU."""
