"""From a `Dae` and a method to CasADi functions, C code and compiled libraries."""
