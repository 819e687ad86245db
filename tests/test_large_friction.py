"""Joint friction in large trees, against the equations of motion in absolute coordinates, which SciPy integrates."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.session.simulation import Settings, Simulation
from solvers.steppers.ida.tree import TreeIDAStepper

BLOCKS, DURATION = 62, 1.0  # more coordinates than small models have; s
COULOMB, STATIC, VISCOUS = 2.0, 3.0, 0.1  # N, N, N s/m
STIFFNESS, DAMPING_RATIO, BETA = 30.0, 0.7, 0.9  # N/m; of the bristle, Dupont et al. 2002

# of a motor of 1 ohm and 1 N m/A on the uppermost block: s, m, V/m, V/(m s), H, 1/m
FILTER_TIME, TARGET, PROPORTIONAL, INTEGRAL, INDUCTANCE, RATIO = 0.02, 0.4, 8.0, 20.0, 1e-3, 2.0


def start(size: float) -> tuple[Any, Any, Any]:
    """Masses, and displacements and velocities of every block against the one below it, for blocks of a size in m."""
    rng = np.random.default_rng(7)
    return rng.uniform(0.5, 2.0, BLOCKS), size * rng.uniform(-0.2, 0.2, BLOCKS), size * rng.uniform(-1.0, 1.0, BLOCKS)


def stack(size: float, *, controlled: bool = False, between_points: bool = False) -> mb.Mechanism:
    """A stack of blocks that slide on each other along one line, held by springs; a motor may drive the uppermost one,
    which a controller positions. The friction is that of the joints, or along the line between points of the blocks.
    """
    m, parent = mb.Mechanism(), None
    for k, (mass, x, v) in enumerate(zip(*start(size), strict=True)):
        joint = mb.Translational(axis="x", start=x, rate=v, fixed=True, nominal=size)
        block = m.body(f"block{k}", parent or m.ground, joint, mass=mass)
        m.force(f"spring{k}", mb.JointSpring(stiffness=STIFFNESS), block)
        given: dict[str, Any] = {
            "coulomb": size * COULOMB, "static": size * STATIC, "stribeck": 0.3 * size, "viscous": VISCOUS,
            "deflection": 2e-3 * size,
        }  # fmt: skip
        if between_points:
            m.force(f"friction{k}", mb.LineFriction(at_b=(5.0 * size, 0, 0), **given), parent or m.ground, block)
        else:
            m.force(f"friction{k}", mb.JointFriction(**given), block)
        parent = block
    assert parent is not None
    if controlled:
        seen = m.lag("seen", parent.position("x"), time_constant=FILTER_TIME, nominal=size)
        gains = {"proportional": PROPORTIONAL, "integral": INTEGRAL}
        control = m.pid("control", TARGET * size, seen, **gains, nominal=size)
        given = {"resistance": 1.0, "inductance": INDUCTANCE, "torque_constant": 1.0, "ratio": RATIO}
        m.dc_motor("motor", parent, control, **given, nominal_current=size)
    m.output("top", parent.position("x"), "Position of the uppermost block")
    m.output("last", parent.coordinate(), "Displacement of the uppermost block on the one below")
    return m


@cache
def reference(*, controlled: bool = False) -> tuple[Any, Any, Any]:
    """Positions of all blocks at the end, in units of the size, their bristles, and the states of the controlled motor:
    filter, integral part and current.
    """
    masses, x, v = start(1.0)
    moved = 1.0 / (1.0 / masses + np.append(0.0, 1.0 / masses[:-1]))  # of two blocks that move against each other
    tau, d = 2.0 * DAMPING_RATIO * np.sqrt(moved * 2e-3 / COULOMB), 2e-3

    def rates(t: float, y: Any) -> Any:
        (x, v, z), (seen, integral, current) = y[:-3].reshape(3, BLOCKS), y[-3:]
        displaced, slip = np.diff(x, prepend=0.0), np.diff(v, prepend=0.0)
        g = 1.0 + (STATIC / COULOMB - 1.0) * np.exp(-((slip / 0.3) ** 2))
        s = np.clip((np.abs(z) / g - BETA) / (1.0 - BETA), 0.0, 1.0)
        alpha = np.where(slip * z > 0.0, s * s * (3.0 - 2.0 * s), 0.0)
        z_rate = (slip - alpha * np.abs(slip) * z / g) / d
        friction = COULOMB * (z + tau * z_rate / (1.0 + (tau * slip / d) ** 2)) + VISCOUS * slip
        force = friction + STIFFNESS * displaced
        if controlled:
            force[-1] -= RATIO * current
        voltage = PROPORTIONAL * (TARGET - seen) + integral
        current_rate = (voltage - current - RATIO * slip[-1]) / INDUCTANCE
        motor = (x[-1] - seen) / FILTER_TIME, INTEGRAL * (TARGET - seen), current_rate
        return np.concatenate((v, (np.append(force[1:], 0.0) - force) / masses, z_rate, motor))

    y = np.concatenate((np.cumsum(x), np.cumsum(v), np.zeros(BLOCKS + 3)))
    found = solve_ivp(rates, (0.0, DURATION), y, method="DOP853", rtol=1e-10, atol=1e-12)
    assert found.success
    x, _, z = found.y[:-3, -1].reshape(3, BLOCKS)
    return x, z, found.y[-3:, -1]


@pytest.mark.parametrize("solver", ["ida", "adams", "auto"])
def test_drives_leave_the_bristles_alone(solver: str) -> None:
    """No degree of freedom but that of the states: joints that turn at a constant speed slide."""
    m, body = mb.Mechanism(), None
    for k in range(BLOCKS):
        joint = mb.Revolute(at=(0.1, 0.0, 0.0), drive=mb.Polynomial((0.0, 1.0)))
        body = m.body(f"link{k}", body or m.ground, joint, mass=1.0, inertia=(0.1, 0.1, 0.1))
        friction = m.force(f"friction{k}", mb.JointFriction(coulomb=COULOMB, deflection=0.01), body)
        m.output(f"torque{k}", friction.effort())
    result = mb.simulate(m, 0.2, interval=0.1, solver=solver)
    for k in range(BLOCKS):
        assert result[f"torque{k}"][-1] == pytest.approx(-COULOMB, rel=1e-5)


def test_locks_leave_the_bristles_alone() -> None:
    """All joints are locked, and released: then the springs move the blocks again."""
    m = stack(1.0)
    for body in m.bodies[1:]:
        m.event(f"lock {body.name}", at=0.05, then=mb.Lock(body))
        m.event(f"release {body.name}", at=0.1, then=mb.Release(body))
    result = mb.simulate(m, 0.2, interval=0.05, solver="ida", tolerance=1e-6)
    assert result["top"][2] == result["top"][1]
    assert abs(result["top"][-1] - result["top"][2]) > 1e-3


@pytest.mark.parametrize("controlled", [False, True])
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(("solver", "tolerance"), [("ida", 1e-7), ("adams", 1e-7), ("esdirk", 1e-6)])
def test_blocks_that_slide_on_each_other(solver: str, tolerance: float, size: float, controlled: bool) -> None:
    positions, bristles, motor = reference(controlled=controlled)
    settings = Settings(solver=solver, tolerance=tolerance)
    simulation = Simulation(stack(size, controlled=controlled), settings, duration=DURATION)
    assert isinstance(simulation.stepper, TreeIDAStepper) is (solver == "ida")
    assert simulation.advance(DURATION).ok
    q, v = simulation.stepper.q, simulation.stepper.v
    assert np.abs(np.cumsum(q) / size - positions).max() < 1e-5
    assert np.abs(v[BLOCKS : 2 * BLOCKS] - bristles).max() < 1e-4
    if controlled:
        assert v[2 * BLOCKS :] / size == pytest.approx(motor, abs=1e-4)


@pytest.mark.parametrize(("solver", "tolerance"), [("ida", 1e-7), ("esdirk", 1e-6)])
def test_blocks_with_friction_between_points(solver: str, tolerance: float) -> None:
    positions, bristles, _ = reference()
    simulation = Simulation(stack(1.0, between_points=True), Settings(solver=solver, tolerance=tolerance))
    assert isinstance(simulation.stepper, TreeIDAStepper) is (solver == "ida")
    assert simulation.advance(DURATION).ok
    q, v = simulation.stepper.q, simulation.stepper.v
    assert np.abs(np.cumsum(q) - positions).max() < 1e-5
    assert np.abs(v[BLOCKS : 2 * BLOCKS] - bristles).max() < 1e-4
