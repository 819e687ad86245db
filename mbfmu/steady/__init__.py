"""Steady states: where a model stays while its drives turn at constant speed, and how it moves near there."""
