"""Projection onto the constraints: coordinate partitions, rank, singular configurations, saddle-point systems."""
