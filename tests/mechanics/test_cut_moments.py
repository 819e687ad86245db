"""Moments of loop-closing joints, by Newton and Euler's equations of a body that a weld carries around."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.util.errors import UserError


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_the_moment_of_a_weld_moves_the_body_that_it_carries(size: float) -> None:
    """F = m (C'' - g) and M = w x I w + (C - P) x F about the point P of the weld, with the center of mass C."""
    rng = np.random.default_rng(3)
    at_a, at_b, com = size * rng.normal(size=(3, 3))
    frame_a, frame_b = Rotation.random(2, random_state=rng)
    rate, mass, g = 3.0 / np.sqrt(size), 2.0 * size**3, np.array([1.0, -4.0, 9.0])
    inertia = mass * size**2 * np.array([[2.0, 0.1, 0.2], [0.1, 1.5, 0.3], [0.2, 0.3, 1.8]])
    m = mb.Mechanism(gravity=g)
    table = m.body("table", m.ground, mb.Revolute(axis="z", drive=mb.Polynomial((0.0, rate))), mass=mass)
    turn = frame_a * frame_b.inv()
    start = (*(at_a - turn.apply(at_b)), *turn.as_quat(scalar_first=True))
    body = m.body("body", m.ground, mb.Floating(start=start), mass=mass, com=com, inertia=inertia)
    joint = mb.WeldCutJoint(at_a=at_a, at_b=at_b, rotation_a=frame_a, rotation_b=frame_b)
    weld = m.cut("weld", joint, table, body)
    for axis in "xyz":
        for on in "ab":
            m.output(f"M{axis}.{on}", weld.joint_moment(axis, on))
    found = mb.simulate(m, 1.0 / rate, interval=0.25 / rate, tolerance=1e-9)
    for k, t in enumerate(found.t):
        around = Rotation.from_rotvec((0.0, 0.0, rate * t))
        attitude, w = around * turn, np.array([0.0, 0.0, rate])
        P, C = around.apply(at_a), around.apply(at_a + turn.apply(com - at_b))
        force = mass * (np.cross(w, np.cross(w, C)) - g)
        R = attitude.as_matrix()
        moment = np.cross(w, R @ inertia @ R.T @ w) + np.cross(C - P, force)
        scale = np.abs(moment).max()
        np.testing.assert_allclose([found[f"M{axis}.b"][k] for axis in "xyz"], moment, atol=1e-6 * scale)
        np.testing.assert_allclose([found[f"M{axis}.a"][k] for axis in "xyz"], -moment, atol=1e-6 * scale)


def test_a_cut_joint_has_a_moment_on_its_bodies_only() -> None:
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    weld = m.cut("w", mb.WeldCutJoint(), m.ground, body)
    with pytest.raises(UserError, match="body of cut 'w' is 'c'"):
        weld.joint_moment("x", "c")
