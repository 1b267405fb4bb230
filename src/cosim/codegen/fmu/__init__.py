"""Generated C code of an FMU: the functions of a model, their derivatives, the solver's step."""
