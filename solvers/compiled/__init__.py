"""Compiled code: kernels, how they call each other, where machine code is kept. The only room that knows numba."""
