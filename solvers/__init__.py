"""Numerics: integrators and partitions that know arrays and callables, not bodies."""
