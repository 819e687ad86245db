"""Identities of a surface for sheet contact: distance, normal, curvature and edges near random points on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics import Mechanism
from mbfmu.mechanics.arrays.compile import filled_record
from mbfmu.mechanics.arrays.numbering import CompiledAttachment, Numbering
from mbfmu.mechanics.arrays.tables import COMPLEX_STEP_NUMBERS, REAL, CalledKernel, compiled
from mbfmu.mechanics.kind import check_element_type, kernel_of, record_of
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE
from mbfmu.sheets import Surface
from mbfmu.sheets.contact.scratch import CONTACT_SCRATCH
from solvers.compiled.kernel import bounds_checked, records
from solvers.compiled.record_view import complex_dtype
from solvers.system import Array

from .identities import Deviation, compare, differences

MAX_ATTEMPTS = 300  # to find a point on the surface
OFFSET_RATIO = 0.1  # largest distance of a point from the surface, of the size of the surface
DEPTH_RATIO = 0.999  # of the core: depth at which the surface still pushes outwards


class Foot(NamedTuple):
    """A point (3,), m, and the unit normal (3,) of the surface there."""

    point: Array
    normal: Array


class Probe:
    """A surface and what its kernel returns, every index checked.

    Parameters
    ----------
    surface
        Surface.
    length
        Size of the surface, m; it is less if a radius of the surface is.
    rng
        Source of the random points.
    """

    def __init__(self, surface: Surface, length: float, rng: np.random.Generator) -> None:
        check_element_type("element", surface, Surface)
        surface.check("the surface")
        self.surface, self.length, self.rng = surface, length, rng
        site = CompiledAttachment("the surface", (), Numbering(Mechanism()), {})
        self.record, gap = filled_record(surface, site)[0], kernel_of(surface, "gap")
        words = tuple(surface.records.items())
        for numbers in (REAL, COMPLEX_STEP_NUMBERS):  # a kernel that cannot be compiled is refused with its reason
            compiled(CalledKernel(gap, record_of(surface), surface.kernels["gap"], words), "gap", numbers)
        self._gap = bounds_checked(gap)
        self._real, self._complex = records(1, CONTACT_SCRATCH), records(1, complex_dtype(CONTACT_SCRATCH))
        edges, curvature = surface.edges(), surface.curvature()
        self.curvature = max(curvature, 1.0 / edges[0] if edges else 0.0)  # largest that is declared, 1/m
        self.size = min(length, surface.core(), 1.0 / self.curvature if self.curvature > 0.0 else np.inf)

    def gap(self, p: Any) -> Any:
        """Return the distance of a point (3,), m, the normal (3,) and the part of the force, (5,) in all."""
        contact = self._complex if np.iscomplexobj(p) else self._real
        contact["p"][0], contact["n"][0], contact["part"][0] = p, np.nan, 1.0
        distance = self._gap(self.record, contact[0])
        return np.concatenate(([distance], contact["n"][0], contact["part"]))

    def slopes(self, p: Array, along: Array) -> tuple[Array, Array]:
        """Return the derivatives (k, 5) of :meth:`gap` along vectors (k, 3), m, and how far they can be trusted."""
        return differences(lambda x: [self.gap(p + x * way) for way in along])

    def feet(self) -> Iterator[Foot]:
        """Yield a random point where the surface is, or none if none is found."""
        for _ in range(MAX_ATTEMPTS):
            p = self.length * self.rng.normal(size=3)
            distance, *normal, _ = self.gap(p)
            point = p - distance * np.array(normal)
            if np.all(np.isfinite(point)):
                _, *there, part = self.gap(point)
                if part > 0.0:
                    yield Foot(point, np.array(there))
                    return

    def places(self) -> Iterator[Array]:
        """Yield a random point (3,), m, near the surface, in front of it or behind."""
        for foot in self.feet():
            yield foot.point + OFFSET_RATIO * self.size * self.rng.uniform(-1.0, 1.0) * foot.normal


def distances(probe: Probe) -> Iterator[Deviation]:
    """The distance is that to the nearest point, which lies along the normal; it reaches down to the core."""
    for p in probe.places():
        distance, *normal, _ = probe.gap(p)
        there = probe.gap(p - distance * np.array(normal))[0]
        yield compare(there, 0.0, ["distance of the point p - gap n, m,"], least=probe.size)
    depth = DEPTH_RATIO * probe.surface.core()
    for foot in probe.feet() if np.isfinite(depth) else ():
        there = probe.gap(foot.point - depth * foot.normal)[0]
        yield compare(there, -depth, ["distance just above the depth core(), m,"], least=probe.size)


def normals(probe: Probe) -> Iterator[Deviation]:
    """The normal is the gradient of the distance, and of unit length."""
    for p in probe.places():
        n = probe.gap(p)[1:4]
        yield compare(n @ n, 1.0, ["square of the length of the normal"])
        slope, unsure = (found[:, 0] / probe.size for found in probe.slopes(p, probe.size * np.eye(3)))
        yield compare(n, slope, [f"component {axis} of the normal" for axis in "xyz"], unsure)


def shape(probe: Probe) -> Iterator[Deviation]:
    """No curvature exceeds what is declared, edges are straight along their axis, and a convex surface is behind its
    tangent planes.
    """
    for foot in probe.feet():
        turn, unsure = (found[:, 1:4] / probe.size for found in probe.slopes(foot.point, probe.size * np.eye(3)))
        found = float(np.abs(np.linalg.eigvalsh(0.5 * (turn + turn.T))).max())
        names = ["largest curvature, 1/m, compared with curvature() and edges(),"]
        yield compare(max(found, probe.curvature), probe.curvature, names, unsure.max(), least=1.0 / probe.size)
        edges = probe.surface.edges()
        if edges is not None:
            axis = np.asarray(edges[2], float)
            yield compare([axis @ axis, foot.normal @ axis], [1.0, 0.0], ["square of the length of the axis of edges()",
                          "component of the normal along the axis of edges()"])  # fmt: skip
        for other in probe.feet() if probe.surface.convex else ():
            above = max(0.0, float(foot.normal @ (other.point - foot.point)))
            yield compare(above, 0.0, ["height above a tangent plane of the convex surface, m,"], least=probe.size)


def complex_distances(probe: Probe) -> Iterator[Deviation]:
    """The kernel is analytic: a step along i e gives the derivatives by differences, and real parts are unchanged."""
    quantities = ["distance", *(f"component {axis} of the normal" for axis in "xyz"), "part"]
    for p in probe.places():
        along = probe.size * probe.rng.normal(size=3)
        (slope,), (unsure,) = probe.slopes(p, along[None])
        found = probe.gap(p + 1j * COMPLEX_STEP_SIZE * along)
        yield compare(found.real, probe.gap(p), [f"real part of the {name}" for name in quantities], least=probe.size)
        names = [f"derivative of the {name}" for name in quantities]
        for k, name in enumerate(names):
            least = probe.size if k == 0 else 1.0
            yield compare(found[k].imag / COMPLEX_STEP_SIZE, slope[k], [name], unsure[k], least=least)


SURFACE_IDENTITIES: dict[str, Callable[[Probe], Iterator[Deviation]]] = {
    "distance from the surface": distances,
    "normal of the surface": normals,
    "shape of the surface": shape,
    "complex steps": complex_distances,
}
