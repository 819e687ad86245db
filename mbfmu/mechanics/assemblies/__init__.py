"""Mechanisms of many bodies that one call adds."""
