"""Friction of joints, lines and wheels, with the colors of :mod:`.forces`."""

from __future__ import annotations

import mbfmu.mechanics as mbm

from .forces import STOP, slider
from .sketch import BLUE, FORCE, GRAY, Sketch, element
from .solids import ball, block, disc, rod


@element("JointFriction")
def joint_friction() -> Sketch:
    """A slide that a pad presses on, and the friction force against its velocity."""
    s, _ = slider(0.5)
    s.show(s.a, STOP, block((0.5, 0.5, 0.16), (0.5, 0.0, 0.52)))
    s.push((0.5, 0.0, 1.35), (0.5, 0.0, 0.66))
    s.slide("x", (1.35, 0.0, 0.35), 0.9)
    s.push((0.0, -0.3, -0.45), (-0.9, -0.3, -0.45))
    return s


@element("SphericalFriction")
def spherical_friction() -> Sketch:
    """A ball in a socket, its rotation and the friction torque against it."""
    s = Sketch(22.0, 26.0)
    b = s.other((0.0, 0.0, 0.25), (0.25, 0.2, 0.0))
    s.show(s.a, GRAY, block((1.5, 1.5, 0.3), (0.0, 0.0, -0.55)), disc(0.62, 0.45, (0.0, 0.0, -0.2)))
    s.show(b, BLUE, ball(0.52), rod((0.0, 0.0, 0.3), (0.0, 0.0, 1.7), 0.14))
    s.turn("z", (0.25, -0.2, 1.3), 0.55, (-150.0, 60.0))
    s.turn("z", (0.1, -0.1, 0.35), 0.85, (40.0, -150.0), color=FORCE)
    return s


@element("CylindricalFriction")
def cylindrical_friction() -> Sketch:
    """A shaft in a sleeve that turns and slides, and the friction against the helical slip."""
    s = Sketch(22.0, 20.0)
    s.show(s.a, GRAY, disc(0.55, 1.0, axis="x"))
    b = s.other((0.0, 0.0, 0.0))
    s.show(b, BLUE, disc(0.33, 3.0, (0.2, 0.0, 0.0), axis="x"))
    s.slide("x", (1.2, 0.0, 0.75), 0.9)
    s.turn("x", (1.25, 0.0, 0.0), 0.62, (-60.0, 150.0))
    s.push((1.3, -0.33, 0.25), (0.75, -0.33, -0.25))
    return s


@element("PlanarFriction")
def planar_friction() -> Sketch:
    """A disk that slides and turns on a plane, and the friction against its velocity."""
    s = Sketch(20.0, 32.0)
    s.show(s.a, GRAY, block((3.2, 2.4, 0.1), (0.2, 0.0, -0.05)))
    b = s.other((0.0, 0.0, 0.12))
    s.show(b, BLUE, disc(0.6, 0.24, axis="z"))
    s.slide("x", (1.2, -0.2, 0.1), 0.9)
    s.turn("z", (0.0, 0.0, 0.45), 0.4, (-120.0, 120.0))
    s.push((-0.62, -0.2, 0.04), (-1.35, -0.2, 0.04))
    return s


@element("LineFriction")
def line_friction() -> Sketch:
    """A rod in a cylinder between two points, its velocity, and the friction of the seal against it."""
    s = Sketch(20.0, 20.0)
    b = s.other((0.6, 0.0, 0.0))
    s.mechanism.force("f", mbm.LineFriction(coulomb=1.0), s.a, b)
    s.show(s.a, GRAY, disc(0.42, 1.5, (-0.6, 0.0, 0.0), axis="x"), ball(0.2, (-1.5, 0.0, 0.0)))
    s.show(b, BLUE, disc(0.16, 1.9, (0.2, 0.0, 0.0), axis="x"), ball(0.2, (1.25, 0.0, 0.0)))
    s.slide("x", (0.95, 0.0, 0.5), 0.9)
    s.push((0.9, -0.3, -0.3), (0.2, -0.3, -0.3))
    return s


@element("SlippingWheel")
def slipping_wheel() -> Sketch:
    """A wheel that is pressed on a road, which pushes it forwards and sideways."""
    s = Sketch(-48.0, 24.0)
    R = 0.95
    s.show(s.a, BLUE, disc(R, 0.4, (0.0, 0.0, R), "y"), disc(0.15, 0.8, (0.0, 0.0, R), "y"))
    s.mechanism.force("f", mbm.SlippingWheel(radius=R, stiffness=1.0, friction=1.0, at_a=(0.0, 0.0, R)), s.a)
    s.show(s.mechanism.ground, GRAY, block((3.4, 2.4, 0.1), (0.0, 0.0, -0.05)))
    for end in ((0.0, -0.25, 0.75), (0.8, -0.25, 0.0), (0.0, -1.1, 0.0)):
        s.line([(0.0, -0.25, 0.0), end], FORCE, heads="end")
    return s
