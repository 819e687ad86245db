"""Multibody mechanisms in relative coordinates, packaged as FMUs."""

__version__ = "0.1.0"
