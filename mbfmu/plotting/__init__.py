"""Plots of results over time and of steady states over a parameter."""
