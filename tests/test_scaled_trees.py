"""No threshold of the steppers of large trees has a unit: scaled copies take the same steps to the same positions.

The factors are powers of two, so that scaling a number rounds nothing.
Sums of LAPACK's may still come in another order: in meshes and loops steps are the same to 6 %, and positions to the
tolerance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fmus.sheet import Sheet
from mbfmu.mechanics import Body, CompiledMechanism, Mechanism, Revolute, RevoluteCutJoint, Translational, rod
from mbfmu.sheets import add_sheet
from solvers import Options, stepper

LINKS = 64
TOLERANCE = 1e-5
ROUNDING = {"adams": 1e-12, "ida": 1e-12, "esdirk": 1e-9}  # what is left of it where steps agree
SCALES = {
    "a thousandth": (2.0**-10, 1.0, 1.0),
    "a thousand times": (2.0**10, 1.0, 1.0),
    "light": (1.0, 2.0**-20, 1.0),
    "slow": (1.0, 1.0, 2.0**6),
    "small, heavy and fast": (2.0**-8, 2.0**10, 2.0**-8),
    "small, of the same material": (2.0**-10, 2.0**-30, 2.0**-10),
    "large, of the same material": (2.0**10, 2.0**30, 2.0**10),
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
    """The same without gravity: only the start determines how fast it moves."""
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


def stretched(length: float, mass: float, time: float) -> CompiledMechanism:
    """A free sheet that spins about its normal, which stretches it."""
    m = Mechanism()
    add_sheet(
        m, "sheet", length=0.125 * length, width=0.0625 * length, thickness=2.0**-11 * length, grid=(5, 5),
        youngs_modulus=2.0**32 * mass / length / time**2, density=1024.0 * mass / length**3, stretch=True,
        rate=(0.25 * length / time, 0.125 * length / time, 0.0, 0.0, 16.0 / time, 0.0),
    )  # fmt: skip
    return CompiledMechanism(m)


def linkages(length: float, mass: float, time: float) -> CompiledMechanism:
    """Slider-cranks, whose loops have angles and lengths."""
    m = Mechanism(gravity=(0.0, -9.8125 * length / time**2, 0.0))
    for k in range(36):
        reach = (0.75 + 0.125 * (k % 3)) * length
        crank = m.body(f"crank{k}", m.ground, Revolute(start=0.625, fixed=True), **rod(mass=mass, length=0.25 * length))
        pin = Revolute(at=(0.25 * length, 0.0, 0.0), start=-0.875)
        link = m.body(f"link{k}", crank, pin, **rod(mass=0.75 * mass, length=reach))
        slider = m.body(f"slider{k}", m.ground, Translational(axis="x", start=length), mass=0.5 * mass)
        m.cut(f"pin{k}", RevoluteCutJoint(at_a=(reach, 0.0, 0.0)), link, slider)
    return CompiledMechanism(m)


def moved(compiled: CompiledMechanism, time: float, solver: str) -> tuple[Any, ...]:
    """Positions at the end of a short run in units of their sizes, and what it took."""
    motion = stepper(solver, compiled.system, 0.0, *compiled.assemble(), Options(rtol=TOLERANCE, duration=10.0 * time))
    assert motion.advance(0.0625 * time).ok
    s = motion.statistics
    return motion.q / compiled.system.position_sizes(compiled.system.size), (s.steps, s.rejected, s.rhs_evals)


@pytest.mark.parametrize(
    ("make", "solver"),
    [
        *((make, solver) for make in (chain, thrown, sheet) for solver in ("adams", "ida", "esdirk")),
        *((make, solver) for make in (stretched, linkages) for solver in ("ida", "esdirk")),
    ],
)
def test_a_scaled_copy_takes_the_same_steps_to_the_same_positions(make: Any, solver: str) -> None:
    q, cost = moved(make(1.0, 1.0, 1.0), 1.0, solver)
    assert cost[0] > 3
    is_mixed = make in (sheet, linkages)
    for name, scale in SCALES.items():
        if make is sheet and name in ("a thousand times", "light"):  # a density that the model refuses
            continue
        q_scaled, cost_scaled = moved(make(*scale), scale[2], solver)
        np.testing.assert_allclose(cost_scaled, cost, rtol=0.06 if is_mixed else 0.0, atol=is_mixed)
        np.testing.assert_allclose(q_scaled, q, rtol=0.0, atol=TOLERANCE if is_mixed else ROUNDING[solver])
