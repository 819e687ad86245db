"""Joints, cut joints and couplings.

Body a is gray, body b blue. Green arrows are free directions, dash-dotted lines axes. A dashed line is the rest of a
loop that a cut joint closes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import mbfmu.mechanics as mbm
import mbfmu.sheets as mbs

from .sketch import BEHIND, BLUE, DARK, GRAY, LINE, MOTION, PICTURES, Sketch, element, pose
from .solids import ball, block, disc, gear, rod

PAPER, FRAME = "#8fb0f0", "#6b7280"  # a sheet, a fixed frame


@dataclass(frozen=True, kw_only=True)
class Pair:
    """A joint and the cut joint with the same constraints: one drawing, the pose of body b, and the loop."""

    draw: Callable[[Sketch, Any], None]
    start: Any = None  # joint coordinates
    axis: str = ""
    view: tuple[float, float] = (22.0, 30.0)  # azimuth and elevation, degrees
    loop: Any  # ends and bulge of the dashed line

    def tree(self, kind: type[mbm.Joint]) -> Sketch:
        """Draw the joint."""
        s = Sketch(*self.view)
        self.draw(s, s.body("b", s.a, kind(start=self.start, **self._axis)))
        return s

    def cut(self, kind: type[mbm.Joint], cut: type[mbm.CutJoint]) -> Sketch:
        """Draw the cut joint, in the pose that the joint gives."""
        s = Sketch(*self.view)
        origin, axes = pose(kind(start=self.start, **self._axis))
        b = s.other(origin, Rotation.from_matrix(axes).as_rotvec())
        s.mechanism.cut("c", cut(**self._axis), s.a, b)
        self.draw(s, b)
        s.loop(*self.loop)
        return s

    @property
    def _axis(self) -> dict[str, Any]:
        return {"axis": self.axis} if self.axis else {}


def weld(s: Sketch, b: Any) -> None:
    """A seam joins two plates."""
    s.show(s.a, GRAY, block((1.7, 0.9, 0.3), (-0.55, 0.0, -0.15)))
    s.show(b, BLUE, block((0.3, 0.9, 1.3), (0.15, 0.0, 0.65)))
    s.show(s.a, DARK, *(ball(0.1, (-0.03, y, 0.03)) for y in np.linspace(-0.42, 0.42, 8)))


def revolute(s: Sketch, b: Any) -> None:
    """A fork, an eye and a pin."""
    for z in (-0.33, 0.33):
        s.show(s.a, GRAY, disc(0.5, 0.24, (0.0, 0.0, z)), block((0.9, 0.6, 0.24), (-0.75, 0.0, z)))
    s.show(s.a, GRAY, block((0.5, 0.6, 0.9), (-1.4, 0.0, 0.0)))
    s.show(b, BLUE, disc(0.5, 0.36), block((1.5, 0.5, 0.32), (0.85, 0.0, 0.0)))
    s.show(s.a, DARK, disc(0.2, 1.3))
    s.axis("z", length=2.6)
    s.turn("z", (0.0, 0.0, 0.85), 0.62)


def translational(s: Sketch, b: Any) -> None:
    """A slide on a square rail."""
    s.show(s.a, GRAY, block((3.4, 0.4, 0.4)))
    s.show(b, BLUE, block((1.0, 0.8, 0.8)))
    s.axis("x", length=4.4)
    s.slide("x", (0.0, 0.0, 0.78), 1.7)


def cylindrical(s: Sketch, b: Any) -> None:
    """A sleeve on a round shaft."""
    s.show(s.a, GRAY, disc(0.2, 3.4, axis="x"))
    s.show(b, BLUE, disc(0.46, 1.0, axis="x"))
    s.axis("x", length=4.4)
    s.slide("x", (0.0, 0.0, 0.9), 1.7)
    s.turn("x", (0.95, 0.0, 0.0), 0.62, (-110.0, 150.0))


def planar(s: Sketch, b: Any) -> None:
    """A block that slides and turns on a plate."""
    s.show(s.a, GRAY, block((3.0, 2.4, 0.16), (0.0, 0.0, -0.08)))
    s.show(b, BLUE, block((0.9, 0.6, 0.5), (0.0, 0.0, 0.33)))
    s.slide("x", (0.0, -0.85, 0.02), 2.2)
    s.slide("y", (1.0, 0.1, 0.02), 1.6)
    s.axis("z", (0.0, 0.0, 0.5), 1.9)
    s.turn("z", (0.0, 0.0, 0.95), 0.5)


def spherical(s: Sketch, b: Any) -> None:
    """A ball in a socket."""
    s.show(s.a, GRAY, disc(0.28, 0.7, (0.0, 0.0, -0.85)), block((1.1, 1.1, 0.16), (0.0, 0.0, -1.2)))
    for z in np.arange(-0.55, 0.0, 0.1):
        s.show(s.a, GRAY, disc(0.06 + 0.62 * np.sqrt(1.0 - (z / 0.66) ** 2), 0.1, (0.0, 0.0, z)))
    s.show(b, BLUE, ball(0.56, (0.0, 0.0, 0.02)), rod((0.0, 0.0, 0.4), (0.0, 0.0, 1.9), 0.17))
    s.turn("z", (0.55, 0.0, 1.75), 0.4)
    s.turn("x", (1.0, 0.0, 0.0), 0.55, (-60.0, 170.0))
    s.turn("y", (-0.05, 0.0, 0.1), 1.15, (120.0, 215.0))


HALF = 0.5 * 0.45  # half the angle of the ball joint, rad
DOWN = (0.0, 0.0, -1.3)
PAIRS = {
    "Weld": Pair(draw=weld, view=(-28.0, 24.0), loop=((-1.4, 0.0, 0.0), (0.1, 0.0, 1.3), (-1.0, 0.0, 0.8))),
    "Revolute": Pair(draw=revolute, axis="z", start=-0.3, loop=((-1.5, 0.0, 0.0), (1.5, -0.4, 0.0), DOWN)),
    "Translational": Pair(draw=translational, axis="x", start=0.3, loop=((-1.7, 0.0, 0.0), (0.3, 0.0, 0.0), DOWN)),
    "Cylindrical": Pair(draw=cylindrical, axis="x", start=(0.0, -0.2), loop=((-1.7, 0.0, 0.0), (-0.2, 0.0, 0.0), DOWN)),
    "Planar": Pair(
        draw=planar, axis="z", start=(0.0, 0.1, 0.35), view=(25.0, 34.0),
        loop=((-1.4, 0.4, 0.0), (-0.2, 0.4, 0.4), (-0.6, 0.0, 1.1)),
    ),
    "Spherical": Pair(
        draw=spherical, start=(np.cos(HALF), 0.0, np.sin(HALF), 0.0),
        loop=((-0.5, 0.0, -1.2), (0.7, 0.0, 1.6), (-1.6, 0.0, 0.8)),
    ),
}  # fmt: skip
for name, own in PAIRS.items():
    of_joint, of_cut = getattr(mbm, name), getattr(mbm, f"{name}CutJoint")
    PICTURES[name] = partial(own.tree, of_joint)
    PICTURES[f"{name}CutJoint"] = partial(own.cut, of_joint, of_cut)


@element("Screw")
def screw() -> Sketch:
    """A nut on a thread."""
    s = Sketch(22.0, 30.0)
    b = s.body("b", s.a, mbm.Screw(axis="x", lead=0.25))
    lean = Rotation.from_rotvec([0.0, 0.0, 0.22]).as_matrix()[:, 0]
    s.show(s.a, GRAY, disc(0.2, 3.4, axis="x"))
    s.show(s.a, GRAY, *(disc(0.28, 0.08, (x, 0.0, 0.0), axis=tuple(lean)) for x in np.linspace(-1.6, 1.6, 20)))
    for angle in (0.0, 1.0, 2.0):
        turned = Rotation.from_rotvec([angle * np.pi / 3.0, 0.0, 0.0]).as_matrix()
        s.show(b, BLUE, mbm.Box(size=(0.8, 0.62, 1.07), rotation=turned))
    s.axis("x", length=4.4)
    s.turn("x", (0.0, 0.0, 0.0), 0.95, (-160.0, 200.0), rise=1.1)
    return s


@element("Universal")
def universal() -> Sketch:
    """A cross between two forks."""
    s = Sketch(28.0, 22.0)
    cross(s, s.body("b", s.a, mbm.Universal(axis="z", second="y", start=(-0.1, -0.35))))
    return s


def cross(s: Sketch, b: Any) -> None:
    """Two forks and the axes of the cross between them."""
    for side in (-0.5, 0.5):
        s.show(s.a, GRAY, block((0.75, 0.34, 0.16), (-0.3, 0.0, side)))
        s.show(b, BLUE, block((0.75, 0.16, 0.34), (0.3, side, 0.0)))
    s.show(s.a, GRAY, block((0.2, 0.34, 1.16), (-0.7, 0.0, 0.0)), rod((-0.7, 0.0, 0.0), (-1.9, 0.0, 0.0), 0.2))
    s.show(b, BLUE, block((0.2, 1.16, 0.34), (0.7, 0.0, 0.0)), rod((0.7, 0.0, 0.0), (1.9, 0.0, 0.0), 0.2))
    s.show(s.a, DARK, disc(0.14, 1.3), disc(0.14, 1.3, axis="y"))
    s.axis("z", length=2.6)
    s.axis("y", length=2.8)
    s.turn("z", (0.0, 0.0, 0.85), 0.45)
    s.turn("y", (0.0, -0.9, 0.0), 0.45, (-60.0, 200.0))


@element("UniversalCutJoint")
def universal_cut() -> Sketch:
    """The same cross, in a loop."""
    s = Sketch(28.0, 22.0)
    origin, axes = pose(mbm.Universal(axis="z", second="y", start=(-0.1, -0.35)))
    b = s.other(origin, Rotation.from_matrix(axes).as_rotvec())
    s.mechanism.cut("c", mbm.UniversalCutJoint(axis="z", second="y"), s.a, b)
    cross(s, b)
    s.loop((-1.9, 0.0, 0.0), (1.8, 0.2, 0.7), DOWN)
    return s


@element("Floating")
def floating() -> Sketch:
    """A body in the air."""
    s = Sketch(30.0, 24.0)
    center = np.array((0.0, 0.0, 0.9))
    b = s.body("b", s.a, mbm.Floating(start=(*center, 1.0, 0.0, 0.0, 0.0)))
    s.show(s.a, GRAY, block((1.7, 1.3, 0.1), (0.1, 0.1, -0.35)))
    s.show(b, BLUE, block((0.9, 0.8, 0.8)))
    for axis, inner in (((1.0, 0.0, 0.0), 0.45), ((0.0, -1.0, 0.0), 0.4), ((0.0, 0.0, 1.0), 0.4)):
        way = np.array(axis)
        s.line((center + inner * way, center + (inner + 1.0) * way), MOTION, heads="end")
        s.turn(way, center + (inner + 0.35) * way, 0.45, (-150.0, 120.0))
    return s


STEP = 1.5  # from node to node of a sheet, which lies in the planes of x and z of its nodes; here y points up
FLAT = Rotation.from_euler("x", 90.0, degrees=True).as_matrix()


def nodes(joint: Any, moved: Any = (0.0, 0.0, 0.0)) -> tuple[Sketch, Any]:
    """Draw two nodes of a sheet, and pale where the flat sheet has the second."""
    s = Sketch(24.0, 20.0)
    s.poses[s.a.index] = (np.zeros(3), FLAT)
    b = s.body("b", s.a, joint, moved)
    size = (0.62, 0.08, 0.9)
    s.show(s.a, GRAY, block(size))
    s.show(b, BLUE, block(size))
    s.show(s.a, LINE, mbm.Box(size=size, at=(STEP, 0.0, 0.0), opacity=0.25))
    return s, b


def marks(s: Sketch, b: Any, middle: Any) -> None:
    """Draw the three free directions of a sheet's node: along the normal of the other, and two rotations."""
    origin, axes = s.poses[b.index]
    s.slide(FLAT[:, 1], FLAT @ (STEP, 0.6, 0.75), 1.2)
    s.turn(axes[:, 2], origin, 0.66, (95.0, 200.0))
    s.turn(axes[:, 0], origin + 0.62 * axes[:, 0], 0.42, (-70.0, 70.0))
    s.line([FLAT @ p for p in middle], DARK, width=3.4, order=BEHIND)


@element("OutOfPlane")
def out_of_plane() -> Sketch:
    """The projected length remains: a straight step in the plane, then one along the normal."""
    s, b = nodes(mbs.OutOfPlane(at=(STEP, 0.0, 0.0), start=(0.85, 0.5, 0.0)))
    marks(s, b, [(0.0, 0.0, 0.0), (STEP, 0.0, 0.0), (STEP, 0.85, 0.0)])
    return s


def bent(alpha: float, theta: float, end: Any) -> list[tuple[float, float, float]]:
    """Return the cubic from the first node to the second."""
    x = np.linspace(0.0, 1.0, 30)
    slope = np.tan(theta) * end[0]
    y = alpha * x**2 * (3.0 - 2.0 * x) + slope * x**2 * (x - 1.0)
    return [(u * end[0], v, 0.0) for u, v in zip(x, y, strict=True)]


@element("Geodesic")
def geodesic() -> Sketch:
    """The length of the bent line remains: the second node moves back towards the first."""
    joint = mbs.Geodesic(at=(STEP, 0.0, 0.0), start=(0.75, 0.9, 0.0))
    s, b = nodes(joint)
    end = FLAT.T @ s.poses[b.index][0]
    line = np.array(bent(end[1], 0.9, end))
    for p, q in pairwise(line):
        way = (q - p) / np.linalg.norm(q - p)
        axes = np.column_stack((way, (0.0, 0.0, 1.0), np.cross(way, (0.0, 0.0, 1.0))))
        s.show(
            s.a,
            PAPER,
            mbm.Panel(size=(1.05 * float(np.linalg.norm(q - p)), 0.9), at=tuple(0.5 * (p + q)), rotation=axes),
        )
    marks(s, b, line)
    return s


@element("Stretching")
def stretching() -> Sketch:
    """Six free directions: also along the plane and about the normal."""
    s, b = nodes(mbs.Geodesic(at=(STEP, 0.0, 0.0), start=(0.75, 0.9, 0.0)), (0.35, 0.0, 0.0))
    origin, axes = s.poses[b.index]
    end = FLAT.T @ origin
    marks(s, b, bent(end[1], 0.9, end))
    s.slide(FLAT[:, 0], tuple(FLAT @ (STEP + 0.1, 0.0, 0.75)), 1.3)
    s.slide(FLAT[:, 2], tuple(FLAT @ (STEP + 0.75, 0.0, 0.0)), 1.1)
    s.turn(axes[:, 1], origin + 0.25 * axes[:, 1], 0.3)
    return s


@element("DistanceCutJoint")
def distance() -> Sketch:
    """A rod with a ball at each end."""
    s = Sketch(20.0, 20.0, bar=0.13)
    b = s.other((1.1, 0.0, 0.5))
    s.mechanism.cut("c", mbm.DistanceCutJoint(at_a=(-1.1, 0.0, -0.5), length=2.417), s.a, b)
    s.show(s.a, GRAY, block((0.8, 0.8, 0.8), (-1.55, 0.0, -0.5)))
    s.show(b, BLUE, block((0.8, 0.8, 0.8), (0.45, 0.0, 0.0)))
    s.turn((2.2, 0.0, 1.0), (0.0, 0.0, 0.0), 0.4)
    s.turn("y", (1.1, 0.0, 0.5), 0.75, (70.0, 160.0))
    s.loop((-1.9, 0.0, -0.5), (1.9, 0.0, 0.5), (0.0, 0.0, -1.2))
    return s


@element("RollingWheel")
def rolling() -> Sketch:
    """A disk that leans over its track."""
    s = Sketch(-48.0, 24.0)
    lean, R = 0.35, 0.95
    b = s.other((0.0, 0.0, R * np.cos(lean)), (lean, 0.0, 0.0))
    s.mechanism.cut("c", mbm.RollingWheel(radius=R), s.a, b)
    s.show(s.a, GRAY, block((3.4, 2.4, 0.1), (0.0, 0.0, -0.05)))
    s.show(b, BLUE, *(disc(R, 0.12, (0.0, 0.0, 0.0), "y"), disc(0.12, 0.5, (0.0, 0.0, 0.0), "y")))
    s.turn(tuple(Rotation.from_rotvec((lean, 0.0, 0.0)).as_matrix()[:, 1]), (0.0, 0.25, R * np.cos(lean)), 0.5)
    s.turn("z", (0.0, 0.1, 2.05), 0.4, (-120.0, 150.0))
    return s


@element("PlaneCutJoint")
def plane() -> Sketch:
    """A point that remains in a plane: five free directions."""
    s = Sketch(25.0, 28.0)
    b = s.other((0.1, 0.0, 0.0), (0.0, 0.3, 0.0))
    s.mechanism.cut("c", mbm.PlaneCutJoint(axis="z"), s.a, b)
    s.show(s.a, GRAY, block((3.0, 2.2, 0.12), (0.0, 0.0, -0.08)))
    s.show(b, BLUE, ball(0.1, (0.0, 0.0, 0.1)))
    s.show(b, BLUE, *(disc(0.05 + 0.027 * k, 0.1, (0.0, 0.0, 0.15 + 0.09 * k)) for k in range(10)))
    s.show(b, BLUE, rod((0.0, 0.0, 0.95), (0.0, 0.0, 1.8), 0.3))
    s.slide("x", (0.1, -0.75, 0.02), 2.2)
    s.slide("y", (1.05, 0.1, 0.02), 1.5)
    for way, at in (("z", (0.62, 0.0, 2.1)), ("x", (1.2, 0.0, 1.1)), ("y", (-0.55, 0.0, 1.2))):
        s.turn(way, at, 0.32, (-120.0, 150.0))
    s.loop((-1.4, 0.3, 0.0), (0.5, 0.0, 1.7), (-0.9, 0.0, 0.9))
    return s


@element("Gear")
def gears() -> Sketch:
    """Two gears on a common carrier."""
    s = Sketch(14.0, 14.0)
    carrier = s.other(name="carrier")
    a = s.body("wheel", carrier, mbm.Revolute(at=(-0.75, 0.0, 0.0), axis="y"))
    b = s.body("b", carrier, mbm.Revolute(at=(0.67, 0.0, 0.0), axis="y", start=0.35))
    s.mechanism.couple("c", mbm.Gear(ratio=-0.5), a, b)
    s.show(s.a, GRAY, block((2.6, 0.1, 0.3), (-0.1, 0.45, 0.0), FRAME))
    s.show(a, GRAY, *gear(0.85, 16, 0.3), disc(0.14, 0.9, axis="y", color=DARK))
    s.show(b, BLUE, *gear(0.47, 9, 0.3), disc(0.14, 0.9, axis="y", color=DARK))
    s.turn("y", (-0.75, -0.3, 0.0), 0.55, (20.0, 160.0))
    s.turn("y", (0.67, -0.3, 0.0), 0.8, (40.0, 140.0))
    return s


@element("Cam")
def cam() -> Sketch:
    """A follower that a cam lifts."""
    s = Sketch(14.0, 14.0)
    wheel = s.body("cam", s.a, mbm.Revolute(axis="y"))
    b = s.body("b", s.a, mbm.Translational(at=(0.0, 0.0, 1.24), axis="z"))
    s.mechanism.couple("c", mbm.Cam("0.3 * sin(q)"), b, wheel)
    s.show(wheel, GRAY, *(disc(0.7 - 0.045 * k, 0.3, (0.0, 0.0, 0.075 * k), axis="y") for k in range(12)))
    s.show(wheel, DARK, disc(0.15, 0.7, axis="y"))
    s.show(b, BLUE, disc(0.22, 0.26, axis="y", color=DARK), block((0.3, 0.2, 1.3), (0.0, 0.0, 0.7)))
    for x in (-0.37, 0.37):
        s.show(s.a, GRAY, block((0.36, 0.4, 0.45), (x, 0.0, 2.0), FRAME))
    s.slide("z", (0.85, 0.0, 1.9), 1.2)
    s.turn("y", (0.0, -0.2, 0.0), 0.95, (20.0, 130.0))
    return s
