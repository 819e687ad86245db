"""Planes are given by any of their points: lengths, constraints and motions do not depend on which."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.modeling.model import as_model

DEPTH = 0.7  # distance of the plane from the origin, m


def rolling(m: mb.Mechanism, body: mb.Body, axes: Any, at: Any) -> None:
    m.cut("contact", mb.RollingWheel(radius=0.3, rotation_a=axes, at_a=at), m.ground, body)


def slipping(m: mb.Mechanism, body: mb.Body, axes: Any, at: Any) -> None:
    wheel = mb.SlippingWheel(radius=0.3, normal=axes[:, 2], at_b=at, friction=0.5, stiffness=1e4, damping=0.5)
    m.force("contact", wheel, body, m.ground)


def point(m: mb.Mechanism, body: mb.Body, axes: Any, at: Any) -> None:
    m.cut("contact", mb.PlaneCutJoint(axis="z", rotation_a=axes, at_a=at, at_b=(0, 0, -0.3)), m.ground, body)


def planar(m: mb.Mechanism, body: mb.Body, axes: Any, at: Any) -> None:
    aside = (at @ axes[:, 0], 0, -0.3)  # any point of the plane of the body, too
    m.cut("contact", mb.PlanarCutJoint(axis="z", rotation_a=axes, at_a=at, at_b=aside), m.ground, body)


@pytest.mark.parametrize("touch", [rolling, slipping, point, planar])
def test_any_point_of_a_plane_may_be_given(touch: Callable[..., None]) -> None:
    """A body moves on a plane at a distance from the origin; the point of the plane is near, or 1000 km away."""
    found = []
    for far in (0.0, 1e6):
        axes = Rotation.random(random_state=4).as_matrix()
        m = mb.Mechanism(gravity=axes @ (1.0, 0.5, -9.81))
        turned = m.body("frame", m.ground, mb.Weld(rotation=axes))
        start = (0.0, 0.0, 0.3 - DEPTH, 1.0, 0.0, 0.0, 0.0)
        body = m.body("body", turned, mb.Floating(start=start), mass=1.0, inertia=(0.1, 0.2, 0.1))
        touch(m, body, axes, axes @ (far, -2.0 * far, -DEPTH))
        m.output("x", body.coordinate(0))
        m.output("y", body.coordinate(1))
        compiled = as_model(m).compile()
        assert compiled.length == pytest.approx(DEPTH, rel=1e-6)
        result = mb.simulate(m, 0.2, solver="radau", tolerance=1e-7)
        assert not result.diagnostics
        found.append((compiled.system.m, result["x"][-1], result["y"][-1]))
    assert found[1] == pytest.approx(found[0], abs=1e-7)
