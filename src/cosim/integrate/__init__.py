"""Road one: SUNDIALS, CasADi's and our own solvers."""
