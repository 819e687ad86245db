"""Linear algebra: small dense matrices as kernels, and blocks along a tree."""
