"""Measures of a run that the studies in this folder define by functions."""

import numpy as np

from mbfmu import Result


def nearest(result: Result) -> float:
    """Return how near coupler and rocker come to one line, rad, as far as outputs show that."""
    between = np.abs(np.mod(result["coupler.angle"] - result["rocker.angle"] + np.pi / 2.0, np.pi) - np.pi / 2.0)
    return float(between.min())
