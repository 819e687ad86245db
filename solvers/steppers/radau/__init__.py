"""Radau IIA of order 5: an implicit one-step method."""
