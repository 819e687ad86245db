"""Multibody mechanisms in relative coordinates, packaged as FMUs."""
