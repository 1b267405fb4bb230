"""Explicit Runge-Kutta methods: coefficients, and C libraries around generated equations."""
