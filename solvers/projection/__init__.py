"""Onto the constraints and along them: partitions of the coordinates, rank, singular positions, saddle systems."""
