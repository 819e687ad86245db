"""A tower of parallelograms with springs, controllers and a motor, and its motion by SciPy in its angles.

The couplers do not turn, so that the angles of the cranks determine everything: with e(x) = (cos x, sin x) coupler k is
at the sum of L e(x_i), i <= k, and the equations of motion follow from the velocities of all centers of mass.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import mbfmu as mb

LENGTH, WIDTH, GRAVITY = 0.2, 0.15, 9.81  # of a crank, of a coupler, m; m/s2
CRANK_MASS, COUPLER_MASS = 0.3, 0.8  # kg
STIFFNESS, DAMPING, SERVO = 400.0, 0.5, 0.8  # N m/rad, N m s/rad; N m s/rad of a filtered rate
FILTER_TIME, RESISTANCE, INDUCTANCE, TORQUE_CONSTANT = 0.05, 1.0, 0.02, 2.0  # s, ohm, H, N m/A
PROPORTIONAL, INTEGRAL = 3.0, 10.0  # V/m, V/(m s)


def start_angles(count: int) -> Any:
    """Angles of the cranks at the start, rad."""
    return 1.2 + 0.4 * np.sin(1.0 + np.arange(count))


def tower(count: int, size: float = 1.0) -> mb.Mechanism:
    """Parallelograms on each other, ``size`` times as large as the constants above: cranks a and b, and a coupler.

    The rate of every crank is filtered and damps it; a motor with a controller on the first crank positions the last
    coupler.
    """
    m, below = mb.Mechanism(gravity=(0.0, -GRAVITY * size, 0.0)), None
    length, width = LENGTH * size, WIDTH * size
    crank, plate = mb.rod(mass=CRANK_MASS, length=length), mb.rod(mass=COUPLER_MASS, length=width)
    for k, angle in enumerate(start_angles(count)):
        base = below or m.ground
        first = m.body(f"a{k}", base, mb.Revolute(start=angle), **crank)
        second = m.body(f"b{k}", base, mb.Revolute(at=(width, 0.0, 0.0), start=angle), **crank)
        below = m.body(f"coupler{k}", first, mb.Revolute(at=(length, 0.0, 0.0), start=-angle), **plate)
        m.cut(f"end{k}", mb.RevoluteCutJoint(at_a=(length, 0.0, 0.0), at_b=(width, 0.0, 0.0)), second, below)
        spring = mb.JointSpring(stiffness=STIFFNESS * size**2, damping=DAMPING * size**2, free=1.2)
        m.force(f"spring{k}", spring, first)
        rate = m.lag(f"rate{k}", first.rate(), time_constant=FILTER_TIME)
        servo = m.weighted_sum(f"servo{k}", [rate], [-SERVO * size**2])
        m.force(f"torque{k}", mb.JointForce(servo), first)
    assert below is not None
    m.output("x", below.position("x"), "Position of the last coupler")
    m.output("energy", m.energy)
    target = size * LENGTH * float(np.cos(start_angles(count)).sum()) + 0.1 * size
    gains = {"proportional": PROPORTIONAL, "integral": INTEGRAL, "nominal": size}
    control = m.pid("control", target, below.position("x"), **gains)
    given = {"resistance": RESISTANCE, "inductance": INDUCTANCE, "torque_constant": TORQUE_CONSTANT * size}
    m.dc_motor("motor", m.bodies[1], control, **given, nominal_current=size)
    return m


def solve_tower(count: int, duration: float) -> tuple[Any, Any]:
    """Angles of the cranks (count,) and states (count + 2,) of the tower of size 1 after a duration (s)."""
    below, shares = np.tril(np.ones((count, count))), np.tril(np.ones((count, count))) - 0.5 * np.eye(count)
    A = LENGTH**2 * (COUPLER_MASS * below.T @ below + 2.0 * CRANK_MASS * shares.T @ shares)
    weight = GRAVITY * LENGTH * (COUPLER_MASS * below + 2.0 * CRANK_MASS * shares).sum(axis=0)
    start = start_angles(count)
    target, turned = LENGTH * np.cos(start).sum() + 0.1, 2.0 * CRANK_MASS * LENGTH**2 / 12.0

    def rates(t: float, y: Any) -> Any:
        x, v, filtered, (integral, current) = y[:count], y[count : 2 * count], y[2 * count : -2], y[-2:]
        apart = x[:, np.newaxis] - x
        torque = -weight * np.cos(x) - STIFFNESS * (x - 1.2) - DAMPING * v - SERVO * filtered
        torque[0] += TORQUE_CONSTANT * current
        acceleration = np.linalg.solve(A * np.cos(apart) + turned * np.eye(count), torque - (A * np.sin(apart)) @ v**2)
        error = target - LENGTH * np.cos(x).sum()
        voltage = PROPORTIONAL * error + integral - RESISTANCE * current - TORQUE_CONSTANT * v[0]
        states = (v - filtered) / FILTER_TIME, [INTEGRAL * error, voltage / INDUCTANCE]
        return np.concatenate((v, acceleration, *states))

    y = np.concatenate((start, np.zeros(2 * count + 2)))
    found = solve_ivp(rates, (0.0, duration), y, method="DOP853", rtol=1e-11, atol=1e-12)
    assert found.success
    return found.y[:count, -1], found.y[2 * count :, -1]
