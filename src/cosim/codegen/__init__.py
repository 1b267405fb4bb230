"""From a Dae and methods to CasADi functions, C code and compiled libraries."""
