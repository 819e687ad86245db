"""Steady states by Newton-Raphson, and natural modes about them."""
