"""A singly diagonally implicit Runge-Kutta method of order 3 on large trees."""
