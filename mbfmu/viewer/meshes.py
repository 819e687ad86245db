"""Triangles of the unit solids, and of bars and surfaces, for files that other programs read."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .hulls import Hull
from .motion import matrices
from .picture import Bar, MeshSolid, Skin

Array = NDArray[np.float64]

CIRCLE_PIECES, HALF_CIRCLE_PIECES = 24, 12  # pieces of a circle, and of half of one
# of a coil: turns, part of its length at each end, wire against its radius
COIL_TURNS, COIL_LEAD, WIRE_RADIUS_RATIO = 8, 0.08, 0.16
UNIT_SQUARE = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * 0.5


@dataclass(frozen=True)
class Mesh:
    """Triangles between points; seen from outside their corners follow one another counterclockwise."""

    points: Array  # (n, 3)
    normals: Array  # (n, 3) unit vectors
    triangles: NDArray[np.int64]  # (k, 3)
    morphs: list[Array] = field(default_factory=list)  # by how much each mode of a bar moves the points, (n, 3)


def grid(points: Array, normals: Array) -> Mesh:
    """Return the mesh of a grid of points (rows, columns, 3); columns x rows points along the normals."""
    rows, columns = points.shape[:2]
    k = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
    triangles = np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)))
    return Mesh(points.reshape(-1, 3), normals.reshape(-1, 3), triangles)


def join_meshes(*meshes: Mesh) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=False)]),
    )


def ring(count: int = CIRCLE_PIECES) -> Array:
    """Return points (count + 1, 3) around z, the first and the last alike."""
    angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
    return np.stack((np.cos(angle), np.sin(angle), 0.0 * angle), axis=1)


def sphere() -> Mesh:
    """Radius 1."""
    polar = np.linspace(np.pi, 0.0, HALF_CIRCLE_PIECES + 1)[:, None, None]
    points = np.sin(polar) * ring() + np.cos(polar) * [0.0, 0.0, 1.0]
    return grid(points, points)


def cylinder() -> Mesh:
    """Radius 1, length 1 along z."""
    z = np.array((0.0, 0.0, 0.5))
    side = grid(np.stack((ring() - z, ring() + z)), np.stack((ring(), ring())))
    caps = []
    for sign in (-1.0, 1.0):
        disc = np.concatenate((np.zeros((1, 3)), ring()[:: int(sign)])) + sign * z
        k = np.arange(1, CIRCLE_PIECES + 1)
        caps.append(Mesh(disc, np.tile(2.0 * sign * z, (len(disc), 1)), np.stack((0 * k, k, k + 1), axis=1)))
    return join_meshes(side, *caps)


def box() -> Mesh:
    """Edges of length 1."""
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = np.roll((sign, 0.0, 0.0), axis)
            points = np.roll(np.column_stack((np.full(4, 0.5 * sign), UNIT_SQUARE[:: int(sign)])), axis, axis=1)
            faces.append(Mesh(points, np.tile(normal, (4, 1)), np.array(((0, 1, 2), (0, 2, 3)))))
    return join_meshes(*faces)


def panel() -> Mesh:
    """A square of side 1 across z; its material shows both sides."""
    points = np.column_stack((UNIT_SQUARE, np.zeros(4)))
    return Mesh(points, np.tile((0.0, 0.0, 1.0), (4, 1)), np.array(((0, 1, 2), (0, 2, 3))))


def coil(slender: float) -> Mesh:
    """Radius 1, length 1 along z; the wire is round where the radius is ``slender`` times the length."""
    u = np.linspace(0.0, 1.0, 24 * COIL_TURNS + 1)
    angle = 2.0 * np.pi * COIL_TURNS * np.clip((u - COIL_LEAD) / (1.0 - 2.0 * COIL_LEAD), 0.0, 1.0)
    out = np.stack((np.cos(angle), np.sin(angle), 0.0 * u), axis=1)
    reach = np.minimum(1.0, np.minimum(u, 1.0 - u) / COIL_LEAD)
    middle = reach[:, None] * out + (u - 0.5)[:, None] * [0.0, 0.0, 1.0]
    about = np.linspace(0.0, 2.0 * np.pi, 9)
    normals = np.cos(about)[:, None] * out[:, None] + np.sin(about)[:, None] * [0.0, 0.0, 1.0]
    points = middle[:, None] + WIRE_RADIUS_RATIO * normals * [1.0, 1.0, slender]
    leaning = normals * [1.0, 1.0, 1.0 / slender]
    return grid(points[:, ::-1], (leaning / np.linalg.norm(leaning, axis=-1, keepdims=True))[:, ::-1])


def facets(solid: MeshSolid) -> Mesh:
    """Return a solid of triangles, each with its own normal."""
    corners = solid.corners()
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, sizes, out=np.tile((0.0, 0.0, 1.0), (len(normals), 1)), where=sizes > 0.0)
    points = corners.reshape(-1, 3)
    return Mesh(points, np.repeat(normals, 3, axis=0), np.arange(len(points)).reshape(-1, 3))


def bar(bar: Bar, scale: float) -> Mesh:
    """Return a straight bar in its frame, and how its modes of amplitude 1 m bend it, ``scale`` times."""
    x, shapes = np.array(bar.x), scale * np.array(bar.shapes)
    corners = UNIT_SQUARE * (bar.height, bar.width)
    slopes = np.gradient(shapes, x, axis=0)
    sides = []
    moved: list[list[Array]] = [[] for _ in range(shapes.shape[1])]
    for k in range(4):
        pair = corners[[k, (k + 1) % 4]]
        y, z = pair[:, 0], pair[:, 1]
        points = np.stack(np.broadcast_arrays(x[:, None], y, z), axis=-1)
        normal = np.cross((1.0, 0.0, 0.0), points[0, 0] - points[0, 1])
        sides.append(grid(points, np.broadcast_to(normal / np.linalg.norm(normal), points.shape)))
        for mode, own in enumerate(moved):
            bent = np.stack((-slopes[:, mode, None] * y, shapes[:, mode, None] + 0.0 * y, np.zeros((len(x), 2))), -1)
            own.append(bent.reshape(-1, 3))
    for end, order in ((0, (0, 3, 2, 1)), (-1, (0, 1, 2, 3))):
        yz = corners[list(order)]
        points = np.column_stack((np.full(4, x[end]), yz))
        normal = np.tile((1.0 if end else -1.0, 0.0, 0.0), (4, 1))
        sides.append(Mesh(points, normal, np.array(((0, 1, 2), (0, 2, 3)))))
        for mode, own in enumerate(moved):
            y = yz[:, 0]
            own.append(np.stack((-slopes[end, mode] * y, shapes[end, mode] + 0.0 * y, 0.0 * y), axis=1))
    whole = join_meshes(*sides)
    return Mesh(whole.points, whole.normals, whole.triangles, [np.concatenate(own) for own in moved])


def hull(hull: Hull, scale: float) -> Mesh:
    """Return a hull in its frame, and how its modes of amplitude 1 m move the points, ``scale`` times."""
    points, corners = np.reshape(hull.points, (-1, 3)), hull.corners
    a, b, c = np.moveaxis(points[corners], 1, 0)
    areas = np.cross(b - a, c - a)
    normals = np.stack([np.bincount(corners.ravel(), np.repeat(part, 3), len(points)) for part in areas.T], axis=1)
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, sizes, out=np.tile((0.0, 0.0, 1.0), (len(normals), 1)), where=sizes > 0.0)
    return Mesh(points, normals, corners, [scale * np.reshape(shape, (-1, 3)) for shape in hull.shapes])


def skin(skin: Skin, places: Array, e: Array) -> Mesh:
    """Return a surface whose points are given in the frames of their bodies; bodies at ``places`` (nb, 3), turned by e.

    Normals are those of the surface as it lies there, in the frames of the bodies too.
    """
    nodes, A = np.array(skin.bodies), matrices(e)
    here = places[nodes] + A[nodes] @ np.array(skin.at)
    normals = np.cross(np.gradient(here, axis=0), np.gradient(here, axis=1))
    size = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(size > 0.0, normals, (0.0, 1.0, 0.0)) / np.where(size > 0.0, size, 1.0)
    turned = np.einsum("...ji,...j->...i", A[nodes], normals)
    whole = grid(np.broadcast_to(skin.at, here.shape), turned)
    return Mesh(whole.points, whole.normals, whole.triangles[:, ::-1])
