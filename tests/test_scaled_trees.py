"""No threshold of the steppers of large trees has a unit: scaled copies take the same steps to the same positions.

The factors are powers of two, so that scaling a number rounds nothing.
Sums of LAPACK's may still come in another order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fmus.sheet import Sheet
from mbfmu.mechanics import Body, CompiledMechanism, Mechanism, Revolute, rod
from solvers import Options, stepper

LINKS = 64
ROUNDING = {"adams": 1e-12, "ida": 1e-12, "esdirk": 1e-9}  # what is left of a tolerance of 1e-5 where steps agree
SCALES = {
    "a thousandth": (2.0**-10, 1.0, 1.0),
    "a thousand times": (2.0**10, 1.0, 1.0),
    "light": (1.0, 2.0**-20, 1.0),
    "slow": (1.0, 1.0, 2.0**6),
    "small, heavy and fast": (2.0**-8, 2.0**10, 2.0**-8),
}
ON_EARTH = {  # the tolerances of a sheet know how far its weight bends it there
    "a thousandth": (2.0**-10, 1.0, 2.0**-5),
    "light": (1.0, 2.0**-10, 1.0),
    "small and heavy": (2.0**-8, 2.0**10, 2.0**-4),
}


def chain(length: float, mass: float, time: float, gravity: float = -9.8125) -> CompiledMechanism:
    """A chain of 1/64 m links that is let go, or thrown."""
    m = Mechanism(gravity=(0.0, gravity * length / time**2, 0.0))
    body: Body = m.ground
    for i in range(LINKS):
        at = (length / LINKS if i else 0.0, 0.0, 0.0)
        joint = Revolute(at=at, start=0.0 if i else -0.25, rate=0.0 if gravity or i % 8 else 2.0 / time)
        body = m.body(str(i), body, joint, **rod(mass=mass / LINKS, length=length / LINKS))
    return CompiledMechanism(m)


def thrown(length: float, mass: float, time: float) -> CompiledMechanism:
    """The same without gravity: only the start says how fast it moves."""
    return chain(length, mass, time, gravity=0.0)


def sheet(length: float, mass: float, time: float) -> CompiledMechanism:
    """A clamped sheet of 9 x 7 nodes under its weight."""
    return CompiledMechanism(
        Sheet(
            nx=9,
            nz=7,
            length=0.25 * length,
            width=0.1875 * length,
            thickness=2.0**-11 * length,
            youngs_modulus=2.0**33 * mass / length / time**2,
            density=1024.0 * mass / length**3,
            gravity_y=-9.8125 * length / time**2,
        ).build()
    )


def moved(compiled: CompiledMechanism, time: float, solver: str) -> tuple[Any, ...]:
    """Positions at the end of a short run in units of their sizes, and what it took."""
    motion = stepper(solver, compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-5))
    assert motion.advance(0.015625 * time).ok
    s = motion.statistics
    return motion.q / compiled.system.size, (s.steps, s.rejected, s.rhs_evals)


@pytest.mark.parametrize("solver", ["adams", "ida", "esdirk"])
@pytest.mark.parametrize(("make", "scales"), [(chain, SCALES), (thrown, SCALES), (sheet, ON_EARTH)])
def test_a_scaled_copy_takes_the_same_steps_to_the_same_positions(make: Any, scales: Any, solver: str) -> None:
    q, cost = moved(make(1.0, 1.0, 1.0), 1.0, solver)
    assert cost[0] > 3
    for scale in scales.values():
        q_scaled, cost_scaled = moved(make(*scale), scale[2], solver)
        assert cost_scaled == cost
        np.testing.assert_allclose(q_scaled, q, rtol=0.0, atol=ROUNDING[solver])
