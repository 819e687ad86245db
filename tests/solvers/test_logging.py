"""SUNDIALS prints nothing that a status reports."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from sksundae.ida import IDA

from solvers.steppers.ida.logging import LOG_VARIABLES, discard_logs, discard_output

RATES = np.logspace(0.0, 8.0, 30)


def stiff(t: float, y: Any, yp: Any, res: Any) -> None:
    """Too much for a Krylov space of one dimension: SUNDIALS warns of its convergence, then gives up."""
    res[:] = yp + RATES[::-1] * (y[::-1] - np.sin(50.0 * t)) + 1e3 * y**3


def test_nothing_reaches_the_console_and_the_environment_stays(capfd: pytest.CaptureFixture[str]) -> None:
    before = {name: os.environ.get(name) for name in LOG_VARIABLES}
    ida = IDA(stiff, rtol=1e-6, atol=1e-8, linsolver="gmres", krylov_dim=1, max_num_steps=500)
    with discard_logs():
        ida.init_step(0.0, np.zeros(30), np.zeros(30))
    with discard_output():
        assert ida.step(10.0).status < 0
    assert {name: os.environ.get(name) for name in LOG_VARIABLES} == before
    assert "".join(capfd.readouterr()) == ""
