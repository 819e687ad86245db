"""A gear on a loop: a parallelogram that swings through its singular configuration turns a wheel."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu import Gear, JointForce, Mechanism, Revolute, RevoluteCutJoint, rod, simulate

CRANK, COUPLER, ROCKER, WHEEL = 1.3, 2.1, 0.7, 0.4  # kg; of the wheel: inertia in kg and lengths of the crank


def geared(length: float, start: float, ratio: float, torque: float) -> Mechanism:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    crank = m.body("crank", m.ground, Revolute(start=start, fixed=True), **rod(mass=CRANK, length=length))
    coupler = m.body(
        "coupler", crank, Revolute(at=(length, 0, 0), start=-start), **rod(mass=COUPLER, length=2 * length)
    )
    rocker = m.body("rocker", coupler, Revolute(at=(2 * length, 0, 0), start=start), **rod(mass=ROCKER, length=-length))
    m.cut("pivot", RevoluteCutJoint(at_a=(-length, 0, 0), at_b=(2 * length, 0, 0)), rocker, m.ground)
    inertia = (WHEEL * length**2,) * 3
    wheel = m.body("wheel", m.ground, Revolute(at=(0, 3 * length, 0), start=ratio * start), mass=1.0, inertia=inertia)
    mesh = m.couple("mesh", Gear(ratio=ratio), wheel, crank)
    m.force("motor", JointForce(magnitude=torque), wheel)
    m.output("angle", crank.angle())
    m.output("mesh", mesh.effort("b"))
    return m


@pytest.mark.parametrize(("solver", "tolerance"), [("adams", 1e-8), ("hybrid", 1e-6), ("ida", 1e-6)])
@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(("start", "ratio"), [(0.4, -2.5), (1e-3, 0.3)])
def test_a_geared_parallelogram_crosses_according_to_one_coordinate(
    start: float, ratio: float, length: float, solver: str, tolerance: float
) -> None:
    torque, stop = 0.05 * 9.81 * length, 4.0 * np.sqrt(length / 9.81)
    loop = (CRANK / 3 + ROCKER / 3 + COUPLER) * length**2

    def weight(q: float) -> float:
        return -9.81 * length * np.cos(q) * (CRANK / 2 + ROCKER / 2 + COUPLER)

    def acceleration(q: float) -> float:
        return (weight(q) + torque * ratio) / (loop + WHEEL * length**2 * ratio**2)

    result = simulate(
        geared(length, start, ratio, torque), stop, interval=stop / 40, solver=solver, tolerance=tolerance
    )
    assert not result.failure
    assert not result.warning
    angle = solve_ivp(
        lambda t, y: [y[1], acceleration(y[0])], (0.0, stop), [start, 0.0], t_eval=result.t, rtol=1e-11, atol=1e-13
    ).y[0]
    assert angle.min() < -np.pi / 2 < 0.0 < angle.max()  # it has crossed
    np.testing.assert_allclose(result["angle"], angle, atol=20.0 * tolerance)
    effort = loop * acceleration(angle) - weight(angle)
    np.testing.assert_allclose(result["mesh"], effort, atol=100.0 * tolerance * np.abs(effort).max())
