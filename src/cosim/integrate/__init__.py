"""Native simulation: SUNDIALS, CasADi's and our own solvers."""
