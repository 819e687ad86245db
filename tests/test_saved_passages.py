"""Saved states include what the check for slow passages of an unstable equilibrium needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from mbfmu.mechanics import Mechanism, Revolute, rod
from mbfmu.mechanics.arrays import systems
from mbfmu.modeling import Model, parameter
from mbfmu.session.simulation import Settings, Simulation

STEP, END = 0.15, 4.0  # s


@dataclass(frozen=True, kw_only=True)
class Swing(Model):
    """A pendulum that starts below and nearly stops at its highest position."""

    name = "swing"
    excess: float = parameter(5e-3, doc="Start rate above the one that reaches the highest position, relative to it")

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        rate = (1.0 + self.excess) * (6.0 * 9.81) ** 0.5
        start = Revolute(start=-0.5 * np.pi, rate=rate, fixed=True)
        m.output("angle", m.body("rod", m.ground, start, **rod(mass=1.0, length=1.0)).angle())
        return m


def record(run: Simulation) -> Callable[[float], Any]:
    """Return what advances a run to a time, and returns outputs and warnings."""

    def advance(t: float) -> tuple[bytes, str]:
        assert run.advance(t).ok
        return run.outputs().tobytes(), run.warning

    return advance


SLOW = {  # excess of the start rate with which the error decides on the passage, by solver and tolerance
    **{(solver, rtol): 5e-3 for solver in ("adams", "hybrid", "tree adams") for rtol in (1e-2, 1e-3)},
    ("radau", 1e-2): 5e-3,
    ("radau", 1e-3): 2e-3,
    ("esdirk", 1e-3): 5e-3,
}


@pytest.mark.parametrize(("solver", "tolerance"), SLOW)
def test_a_restored_run_reports_the_same_slow_passage(solver: str, tolerance: float, monkeypatch: Any) -> None:
    model = Swing(excess=SLOW[solver, tolerance])
    if solver in ("tree adams", "esdirk"):
        monkeypatch.setattr(systems, "MAX_DENSE_TREE_COORDINATES", 0)
    settings = Settings(solver=solver.rpartition(" ")[2], tolerance=tolerance)
    times = np.arange(1, round(END / STEP)) * STEP
    whole, saved, told = Simulation(model, settings), [], []
    for t in times:
        saved.append(whole.save())
        told.append(record(whole)(float(t)))
    assert any("just passed an unstable equilibrium" in verdict for _, verdict in told)
    for k in range(1, len(saved), 2):
        other = Simulation(model, settings)
        other.restore(saved[k])
        assert [record(other)(float(t)) for t in times[k:]] == told[k:]
