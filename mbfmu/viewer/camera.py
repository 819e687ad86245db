"""Where a motion is looked at from: a camera that shows all of it, the same on the page and in pictures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import cos, radians, sin, tan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .motion import Motion
from .picture import numbers

Array = NDArray[np.float64]

FIELD_OF_VIEW = 25.0  # vertical field of view, degrees
STAGE_FRAMES = 200  # enough to find the space a motion takes
EXTENT_DIRECTIONS = 150  # in which the outermost points are looked for
FILLED_PART = 0.88  # part of a picture that is filled
PLANE_MOTION_RATIO = 0.15  # thinner than this, against its size, a motion counts as plane


@dataclass(frozen=True)
class Stage:
    """The space a motion takes, along axes (right, up, front), and the direction to look at it from.

    The camera is in the direction cos(elevation) (cos(azimuth) front + sin(azimuth) right) + sin(elevation) up.
    """

    axes: tuple[tuple[float, ...], ...]  # unit vectors right, up, front in global axes
    center: tuple[float, ...]  # of the box the motion stays in, along these axes, m
    half: tuple[float, ...]  # half the box's edges, m
    outermost: tuple[tuple[float, ...], ...]  # points the motion reaches, along these axes, m
    azimuth: float  # degrees
    elevation: float

    @classmethod
    def of(cls, *motions: Motion) -> Stage:
        """Find the stage of one or more motions; up is that of the first."""
        axes = basis(np.array(motions[0].picture.up))
        clouds = [cloud for motion in motions for cloud in points_of_motion(motion)]
        cloud = np.concatenate(clouds or [np.zeros((1, 3))]) @ axes.T
        low, high = cloud.min(axis=0), cloud.max(axis=0)
        half = 0.5 * (high - low)
        half = np.maximum(half, 1e-3 * (half.max() or 1.0))
        farthest = np.unique(np.argmax(cloud @ np.transpose(directions(EXTENT_DIRECTIONS)), axis=0))
        return cls(
            tuple(map(numbers, axes)),
            numbers(0.5 * (low + high)),
            numbers(half),
            tuple(map(numbers, cloud[farthest])),
            *direction(half),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return plain lists and numbers, for JSON."""
        return {**asdict(self), "field": FIELD_OF_VIEW}


@dataclass(frozen=True)
class Camera:
    """A perspective camera: ``eye`` (m), the rows right, up and backward of ``axes``, and the focal length."""

    eye: Array
    axes: Array
    focal: float  # picture heights

    @classmethod
    def looking_at(cls, stage: Stage, aspect: float, azimuth: float, elevation: float) -> Camera:
        """Return the camera that shows the whole stage in a picture of this width to height; angles in degrees."""
        base = np.array(stage.axes)
        a, b = radians(azimuth), radians(elevation)
        back = np.array([cos(b) * sin(a), sin(b), cos(b) * cos(a)])
        right = np.array([cos(a), 0.0, -sin(a)])
        own = np.stack((right, np.cross(back, right), back))
        points = np.array(stage.outermost) @ own.T
        eye = np.array([0.0, 0.0, -np.inf])
        for k, part in ((0, aspect), (1, 1.0)):  # |x - eye| <= slope (eye_z - z) for all points
            slope = FILLED_PART * part * tan(radians(0.5 * FIELD_OF_VIEW))
            ahead, behind = np.max(slope * points[:, 2] + points[:, k]), np.max(slope * points[:, 2] - points[:, k])
            eye[k] = 0.5 * (ahead - behind)
            eye[2] = max(eye[2], 0.5 * (ahead + behind) / slope)
        eye = eye @ own
        return cls(eye @ base, own @ base, 0.5 / tan(radians(0.5 * FIELD_OF_VIEW)))

    def project(self, points: Array) -> tuple[Array, Array]:
        """Return picture coordinates (..., 2), in picture heights from the middle, and depths (...) in m."""
        seen = (points - self.eye) @ self.axes.T
        depth = np.maximum(-seen[..., 2], 1e-9)
        return self.focal * seen[..., :2] / depth[..., None], depth


def points_of_motion(motion: Motion) -> list[Array]:
    """Return points (k, 3) that a motion reaches, global axes, m."""
    frames = np.unique(np.linspace(0, len(motion.times) - 1, STAGE_FRAMES).astype(int))
    clouds = [motion.point(body, at, frames).reshape(-1, 3) for body, at in motion.picture.points().items()]
    clouds += [motion.axis(bar, frames).reshape(-1, 3) for bar in motion.picture.bars]
    return clouds + [motion.hull_points(hull, frames).reshape(-1, 3) for hull in motion.picture.hulls]


def directions(count: int) -> Array:
    """Return unit vectors (count, 3) spread over the sphere along a spiral."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    wide = np.sqrt(1.0 - z * z)
    return np.stack((wide * np.cos(turn), wide * np.sin(turn), z), axis=-1)


def basis(up: Array) -> Array:
    """Return unit vectors right, up, front as rows; x to the right unless it points up."""
    first = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
    right = first - (first @ up) * up
    right /= np.linalg.norm(right)
    return np.stack((right, up, np.cross(right, up)))


def direction(half: Array) -> tuple[float, float]:
    """Return azimuth and elevation (degrees): nearly along the normal of a plane motion, else from above a corner."""
    thin = int(np.argmin(half))
    if half[thin] > PLANE_MOTION_RATIO * half.max():
        return 35.0, 20.0
    return ((72.0, 12.0), (30.0, 50.0), (18.0, 12.0))[thin]
