"""Sketches of the elements of the reference."""
