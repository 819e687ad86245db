"""Mechanisms of the literature at any size, with their motions from equations that were derived by hand."""
