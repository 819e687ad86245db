"""Forces, elements of sheets and beams, and surfaces.

Body a is gray, body b blue. Red arrows are forces and moments, green ones the motion they depend on.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import mbfmu.mechanics as mbm

from .joints import FRAME, PAPER
from .sketch import BEFORE, BLUE, DARK, FORCE, GRAY, LINE, MOTION, Sketch, element
from .solids import ball, block, disc, rod

RUBBER, STOP = "#5d6472", "#c2564b"


def slider(place: float, joint: Any = None, bar: float = 0.001) -> tuple[Sketch, Any]:
    """Return a block on a rail that stands on a wall."""
    s = Sketch(20.0, 24.0, bar=bar)
    b = s.body("b", s.a, joint or mbm.Translational(axis="x", start=place))
    s.show(s.a, GRAY, block((0.2, 1.1, 1.2), (-1.7, 0.0, 0.0)), block((3.3, 0.16, 0.16)))
    s.show(b, BLUE, block((0.7, 0.6, 0.6)))
    return s, b


@element("Spring")
def spring() -> Sketch:
    """A coil between points of two free bodies."""
    s = Sketch(20.0, 20.0, bar=0.13)
    b = s.other((0.85, 0.0, 0.45), (0.0, -0.35, 0.0))
    s.mechanism.force("f", mbm.Spring(stiffness=1.0, at_a=(-0.85, 0.0, -0.3)), s.a, b)
    s.show(s.a, GRAY, block((0.7, 0.7, 0.7), (-1.2, 0.0, -0.3)))
    s.show(b, BLUE, block((0.8, 0.7, 0.7), (0.4, 0.0, 0.0)))
    way = np.array((1.7, 0.0, 0.75)) / np.hypot(1.7, 0.75)
    for end, sign in ((np.array((-0.85, -0.2, 0.1)), 1.0), (np.array((0.8, -0.2, 0.85)), -1.0)):
        s.push(tuple(end), tuple(end + 0.65 * sign * way))
    return s


@element("JointSpring")
def joint_spring() -> Sketch:
    """A coil about the rail of a slide."""
    s, b = slider(0.7, mbm.Translational(at=(-1.6, 0.0, 0.0), axis="x", start=2.1), bar=0.17)
    s.mechanism.force("f", mbm.JointSpring(stiffness=1.0), b)
    s.slide("x", (0.5, 0.0, 0.65), 1.3)
    return s


def dashpot(s: Sketch, start: float, end: float, height: float) -> None:
    """A cylinder on body a and a piston rod, along x."""
    middle = 0.5 * (start + end) + 0.25
    s.show(s.a, RUBBER, rod((start, 0.0, height), (middle, 0.0, height), 0.24))
    s.show(s.a, DARK, rod((middle - 0.1, 0.0, height), (end, 0.0, height), 0.08))


@element("Damper")
def damper() -> Sketch:
    """A cylinder with a piston rod between two free bodies."""
    s = Sketch(20.0, 20.0)
    b = s.other((1.2, 0.0, 0.0))
    s.mechanism.force("f", mbm.Damper(damping=1.0), s.a, b)
    s.show(s.a, GRAY, block((0.7, 0.7, 0.7), (-1.4, 0.0, 0.0)))
    s.show(b, BLUE, block((0.7, 0.7, 0.7), (0.3, 0.0, 0.0)))
    dashpot(s, -1.05, 1.15, 0.0)
    s.push((-0.95, -0.3, 0.5), (-0.3, -0.3, 0.5))
    s.push((1.05, -0.3, 0.5), (0.4, -0.3, 0.5))
    s.slide("x", (1.5, 0.0, 0.65), 1.1)
    return s


@element("JointDamper")
def joint_damper() -> Sketch:
    """A cylinder with a piston rod along the rail of a slide."""
    s, b = slider(0.9)
    s.mechanism.force("f", mbm.JointDamper(damping=1.0), b)
    dashpot(s, -1.6, 0.6, 0.42)
    s.slide("x", (0.9, 0.0, 0.75), 1.2)
    s.push((0.5, -0.4, 0.0), (-0.3, -0.4, 0.0))
    return s


def hinge(angle: float = 0.9) -> tuple[Sketch, Any]:
    """Return two bars on a pin."""
    s = Sketch(14.0, 22.0)
    b = s.body("b", s.a, mbm.Revolute(axis="y", start=-angle))
    s.show(s.a, GRAY, block((1.9, 0.24, 0.4), (0.85, 0.0, 0.0)), disc(0.34, 0.24, axis="y"))
    s.show(b, BLUE, block((1.9, 0.24, 0.4), (0.85, -0.27, 0.0)), disc(0.34, 0.24, (0.0, -0.27, 0.0), axis="y"))
    s.show(s.a, DARK, disc(0.13, 0.9, (0.0, -0.15, 0.0), axis="y"))
    return s, b


@element("TorsionSpring")
def torsion_spring() -> Sketch:
    """A spiral about the pin of a hinge."""
    s, _ = hinge()
    phi = np.linspace(0.0, 5.3 * np.pi, 200)
    radius = 0.14 + 0.036 * phi
    x, z = radius * np.cos(phi), radius * np.sin(phi)
    s.line(np.column_stack((x, np.full_like(x, -0.62), z)), DARK, width=2.4)
    s.turn("y", (0.0, -0.4, 0.0), 1.55, (90.0 - 46.0, 90.0 - 4.0), color=FORCE)
    return s


@element("Bushing")
def bushing() -> Sketch:
    """A rubber ring between a sleeve and a pin."""
    s = Sketch(24.0, 18.0)
    b = s.other()
    s.mechanism.force("f", mbm.Bushing(stiffness=1.0), s.a, b)
    for angle in np.arange(0.0, 360.0, 15.0):
        turned = Rotation.from_euler("y", angle, degrees=True).as_matrix()
        s.show(s.a, GRAY, mbm.Box(size=(0.28, 0.8, 0.26), at=tuple(turned @ (0.0, 0.0, 0.92)), rotation=turned))
    s.show(s.a, RUBBER, disc(0.8, 0.66, axis="y"))
    s.show(b, BLUE, disc(0.3, 2.4, (0.0, -0.2, 0.0), axis="y"))
    s.slide("x", (0.0, -1.0, -0.48), 1.0)
    s.slide("z", (0.52, -1.0, 0.0), 1.0)
    s.turn("y", (0.0, -1.25, 0.0), 0.45, (-60.0, 200.0))
    return s


@element("JointStop")
def joint_stop() -> Sketch:
    """A slide between two stops."""
    s, _ = slider(0.75)
    for x in (-0.9, 1.35):
        s.show(s.a, STOP, block((0.22, 0.5, 0.6), (x, 0.0, 0.0)))
    s.slide("x", (0.2, 0.0, 0.7), 2.0)
    s.push((1.75, -0.3, 0.0), (1.12, -0.3, 0.0))
    return s


@element("DistanceStop")
def distance_stop() -> Sketch:
    """A slack rope between two bodies."""
    s = Sketch(20.0, 20.0)
    b = s.other((0.9, 0.0, 0.4))
    s.mechanism.force("f", mbm.DistanceStop(upper=2.0, stiffness=1.0), s.a, b)
    s.show(s.a, GRAY, block((0.7, 0.7, 0.7), (-1.2, 0.0, 0.4)))
    s.show(b, BLUE, block((0.7, 0.7, 0.7), (0.3, 0.0, 0.0)))
    x = np.linspace(-0.85, 0.87, 40)
    rope = np.column_stack((x, np.full_like(x, -0.1), 0.4 - 0.75 * (1.0 - (x / 0.86) ** 2)))
    s.line(rope, "#b8860b", width=3.4)
    s.line([(-0.85, -0.1, 1.0), (0.9, -0.1, 1.0)], LINE, heads="both", width=2.0)
    for end in (-0.85, 0.9):
        s.line([(end, -0.1, 0.75), (end, -0.1, 1.15)], LINE, width=1.6)
    return s


@element("JointForce")
def joint_force() -> Sketch:
    """A force along the joint coordinate, and its reaction."""
    s, _ = slider(0.1)
    s.push((0.5, 0.0, 0.0), (1.5, 0.0, 0.0))
    s.push((-1.55, -0.3, 0.3), (-2.5, -0.3, 0.3))
    s.slide("x", (0.1, 0.0, 0.62), 1.2)
    return s


@element("LineForce")
def line_force() -> Sketch:
    """A force that pushes points of two free bodies apart, along the line between them."""
    s = Sketch(20.0, 20.0)
    b = s.other((1.1, 0.0, 0.5), (0.0, -0.35, 0.0))
    start, end = np.array((-0.95, -0.4, -0.35)), np.array((0.95, -0.4, 0.45))
    s.mechanism.force("f", mbm.LineForce(magnitude=1.0), s.a, b)
    s.show(s.a, GRAY, block((0.7, 0.7, 0.7), (-1.2, 0.0, -0.45)))
    s.show(s.a, DARK, ball(0.09, tuple(start)), ball(0.09, tuple(end)))
    s.show(b, BLUE, block((0.7, 0.7, 0.7), (0.15, 0.0, 0.0)))
    way = (end - start) / np.linalg.norm(end - start)
    s.line([tuple(start), tuple(end)], LINE, width=2.0)
    s.push(tuple(start + 0.75 * way), tuple(start + 0.05 * way))
    s.push(tuple(end - 0.75 * way), tuple(end - 0.05 * way))
    return s


@element("PointForce")
def point_force() -> Sketch:
    """A force at a point of a body."""
    s = Sketch(28.0, 24.0)
    b = s.other(turned=(0.0, 0.0, 0.2))
    s.mechanism.force("f", mbm.PointForce(magnitude=1.0), b)
    s.show(b, BLUE, block((1.7, 1.0, 0.8)), ball(0.1, (0.6, -0.3, 0.42), DARK))
    s.push((0.66, -0.2, 1.75), (0.66, -0.2, 0.5))
    return s


@element("Torque")
def torque() -> Sketch:
    """A torque on a body."""
    s = Sketch(28.0, 24.0)
    b = s.other(turned=(0.0, 0.0, 0.2))
    s.mechanism.force("f", mbm.Torque(magnitude=1.0), b)
    s.show(b, BLUE, block((1.7, 1.0, 0.8)))
    s.axis("z", (0.0, 0.0, 0.3), 2.4)
    s.turn("z", (0.0, 0.0, 0.8), 0.62, (-160.0, 120.0), color=FORCE, heads="end", width=3.6)
    return s


@element("BeamElement")
def beam_element() -> Sketch:
    """A bent beam between two bodies."""
    s = Sketch(20.0, 22.0)
    b = s.other((1.1, 0.0, 0.6), (0.0, -0.5, 0.0))
    x = np.linspace(0.0, 1.0, 25)
    z = 0.6 * x**2 * (3.0 - 2.0 * x) + 2.0 * np.tan(0.5) * x**2 * (x - 1.0)
    points = np.column_stack((-0.9 + 2.0 * x, np.zeros_like(x), z))
    s.show(s.a, PAPER, *(rod(tuple(p), tuple(q), 0.13) for p, q in pairwise(points)))
    s.show(s.a, GRAY, block((0.5, 0.8, 0.8), (-1.1, 0.0, 0.0)))
    s.show(b, BLUE, block((0.5, 0.8, 0.8), (0.2, 0.0, 0.0)))
    return s


def cell(surface: Any, nodes: bool = True) -> Sketch:
    """Return four nodes and the surface between them, a skin through a grid of bodies."""
    s = Sketch(28.0, 30.0)
    steps = np.linspace(0.0, 1.0, 11)
    grid = [[s.other(surface(u, v), name=f"{u} {v}") for v in steps] for u in steps]
    s.mechanism.surface("skin", grid, color=PAPER)
    if nodes:
        corners = [surface(u, v) for u in (0.0, 1.0) for v in (0.0, 1.0)]
        s.show(s.a, BLUE, *(ball(0.11, tuple(map(float, corner))) for corner in corners))
    return s


def rolled(u: float, v: float) -> tuple[float, float, float]:
    """Return a point of a surface that is bent about one axis."""
    return 2.2 * (u - 0.5), 1.8 * (v - 0.5), 0.9 * (2.0 * u - 1.0) ** 2


def domed(u: float, v: float) -> tuple[float, float, float]:
    """Return a point of a surface that is bent about two axes, with a general quadrilateral below it."""
    x, y = 2.0 * u - 1.0, 2.0 * v - 1.0
    return x * (1.2 - 0.25 * y), y * (0.95 + 0.2 * x), 1.0 - 0.5 * x**2 - 0.5 * y**2


@element("Plate")
def plate() -> Sketch:
    """Single curvature."""
    return cell(rolled)


@element("Shell")
def shell() -> Sketch:
    """Double curvature."""
    return cell(domed)


@element("pressure")
def pressure() -> Sketch:
    """Forces normal to a surface."""
    s = cell(lambda u, v: (2.4 * (u - 0.5), 1.8 * (v - 0.5), 0.0), nodes=False)
    for x in (-0.9, -0.3, 0.3, 0.9):
        for y in (-0.6, 0.0, 0.6):
            s.line([(x, y, 0.8), (x, y, 0.05)], FORCE, heads="end", width=2.0)
    return s


def strip(points: Any, width: float = 0.9) -> list[Any]:
    """Return a sheet along points (k, 3) of the x-z plane."""
    panels = []
    for p, q in pairwise(points):
        way = (q - p) / np.linalg.norm(q - p)
        axes = np.column_stack((way, (0.0, 1.0, 0.0), np.cross(way, (0.0, 1.0, 0.0))))
        size = (1.06 * float(np.linalg.norm(q - p)), width)
        panels.append(mbm.Panel(size=size, at=tuple(0.5 * (p + q)), rotation=axes))
    return panels


def contact(view: tuple[float, float], line: Any, touched: tuple[Any, Any], *solids: Any) -> Sketch:
    """Return a sheet on a surface, with the force at a point where they touch."""
    s = Sketch(*view)
    b = s.other()
    s.show(s.a, GRAY, *solids)
    s.show(b, BLUE, *strip(np.array(line)))
    s.push(*touched, order=BEFORE)
    return s


@element("Wall")
def wall() -> Sketch:
    """A plane."""
    x = np.linspace(-1.2, 1.3, 24)
    line = np.column_stack((x, 0.0 * x, 0.05 + 0.45 * np.maximum(x - 0.1, 0.0) ** 2))
    slab = strip(np.column_stack((np.linspace(-1.7, 1.7, 30), np.zeros(30), np.zeros(30))), 1.9)
    return contact((24.0, 26.0), line, ((-0.7, 0.0, 0.05), (-0.7, 0.0, 1.0)), *slab)


@element("Guide")
def guide() -> Sketch:
    """A plate with round edges."""
    x = np.linspace(-1.5, 1.6, 24)
    line = np.column_stack((x, 0.0 * x, 0.22 + 0.3 * (np.abs(x) > 1.0) * (np.abs(x) - 1.0) * -1.5))
    ends = [disc(0.16, 1.4, (x, 0.0, 0.0), axis="y") for x in (-1.0, 1.0)]
    return contact((20.0, 22.0), line, ((0.2, 0.0, 0.22), (0.2, 0.0, 1.1)), block((2.0, 1.4, 0.32)), *ends)


@element("Drum")
def drum() -> Sketch:
    """The outside of a cylinder."""
    phi = np.radians(np.linspace(150.0, 40.0, 24))
    arc = np.column_stack((0.95 * np.cos(phi), 0.0 * phi, 0.95 * np.sin(phi)))
    arc = np.concatenate((arc, [arc[-1] + (0.5, 0.0, -0.6)]))
    return contact((24.0, 22.0), arc, ((0.0, 0.0, 0.96), (0.0, 0.0, 1.7)), disc(0.9, 1.5, axis="y"))


@element("Trough")
def trough() -> Sketch:
    """The inside of a part of a cylinder."""
    phi = np.radians(np.linspace(190.0, 350.0, 24))
    outer = np.column_stack((1.2 * np.cos(phi), 0.0 * phi, 1.2 * np.sin(phi)))
    s = contact((22.0, 34.0), 0.95 * outer[3:-7], ((0.0, 0.0, -1.12), (0.0, 0.0, -0.25)))
    s.show(s.a, GRAY, *strip(outer, 1.5))
    return s


@element("nip")
def nip() -> Sketch:
    """A sheet between a driven roller and an idler."""
    x = np.linspace(-1.6, 1.6, 24)
    s = Sketch(22.0, 20.0)
    b = s.other()
    s.show(s.a, GRAY, disc(0.6, 1.3, (0.0, 0.0, -0.62), axis="y"), disc(0.12, 1.9, (0.0, 0.0, -0.62), "y", DARK))
    s.show(s.a, FRAME, disc(0.4, 1.3, (0.0, 0.0, 0.42), axis="y"), disc(0.1, 1.9, (0.0, 0.0, 0.42), "y", DARK))
    s.show(b, BLUE, *strip(np.column_stack((x, 0.0 * x, 0.0 * x)), 1.1))
    s.turn("y", (0.0, -1.0, -0.62), 0.42, (30.0, 250.0), color=FORCE, heads="start", width=3.0)
    s.push((0.0, 0.0, 1.55), (0.0, 0.0, 0.85))
    s.line([(1.0, -0.3, 0.1), (1.9, -0.3, 0.1)], MOTION, heads="end")
    return s


@element("rope")
def rope() -> Sketch:
    """A rope from a ceiling about a pulley with a load, over a second pulley, to a weight."""
    s = Sketch(14.0, 14.0)
    low, weight = s.other((-0.45, 0.0, -0.5), name="b"), s.other((1.15, 0.0, -0.2), name="c")
    path = [(s.a, (-0.8, 0.0, 1.4)), (low, (-0.35, 0.0, 0.0)), (low, (0.35, 0.0, 0.0)), (s.a, (0.0, 0.0, 0.8))]
    path += [(s.a, (0.8, 0.0, 0.8)), (weight, (-0.35, 0.0, -0.25))]
    s.mechanism.rope("rope", path, length=5.0, stiffness=1.0)
    s.show(s.a, GRAY, block((3.2, 0.7, 0.2), (0.2, 0.0, 1.5)), disc(0.4, 0.2, (0.4, 0.0, 0.8), axis="y"))
    s.show(low, BLUE, disc(0.35, 0.2, axis="y"), block((0.6, 0.5, 0.5), (0.0, 0.0, -0.85)))
    s.show(weight, BLUE, block((0.5, 0.5, 0.5), (-0.35, 0.0, -0.5)))
    arc = np.linspace(0.0, np.pi, 40)
    under = np.column_stack((-0.45 - 0.35 * np.cos(arc), np.full(40, -0.13), -0.5 - 0.35 * np.sin(arc)))
    over = np.column_stack((0.4 - 0.4 * np.cos(arc), np.full(40, -0.13), 0.8 + 0.4 * np.sin(arc)))
    ends = ((-0.8, -0.13, 1.4), (0.8, -0.13, -0.45))
    s.line((ends[0], *under, *over, ends[1]), LINE, width=2.6)
    s.push((-0.8, -0.2, -0.2), (-0.8, -0.2, 0.6))
    s.push((-0.05, -0.2, -0.2), (-0.05, -0.2, 0.45))
    s.push((0.8, -0.2, -0.4), (0.8, -0.2, 0.35))
    return s
