"""Compiled code: kernels, calls between them, cache of machine code. The only package that imports numba."""
