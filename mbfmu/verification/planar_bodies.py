"""Planar mechanisms in absolute coordinates, integrated by SciPy.

This formulation is independent of mbfmu, which uses relative coordinates and recursions: each body has the coordinates
x and y of its center of mass and its angle, and the constraints are equations of accelerations (index 1),

    M a + J^T lambda = f,    J a = -J' v.

Positions and velocities are projected onto the constraints at every output time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from .references import Pushed

Array = NDArray[np.float64]
Point = tuple[int, tuple[float, float]]  # number of a body, -1: the ground; and a point in its frame, m
GROUND_NUMBER = -1
RTOL, COARSE_RTOL = 1e-11, 1e-9
NEWTON_ITERATIONS = 8


@dataclass
class PlanarBodies:
    """Rigid bodies in a plane with pins, straight guides, springs and constant torques.

    Attributes
    ----------
    gravity
        Acceleration along -y, m/s^2.
    size, rate_size
        Length of the mechanism, m, and size of the rates of the motion, 1/s, to which errors are relative.
    """

    gravity: float
    size: float
    rate_size: float
    masses: list[float] = field(default_factory=list)
    inertias: list[float] = field(default_factory=list)
    start: list[float] = field(default_factory=list)
    rates: list[float] = field(default_factory=list)
    pins: list[tuple[Point, Point]] = field(default_factory=list)
    guides: list[tuple[Point, tuple[float, float], float]] = field(default_factory=list)
    springs: list[tuple[Point, Point, float, float]] = field(default_factory=list)
    torques: list[tuple[int, float]] = field(default_factory=list)

    def add(
        self,
        mass: float,
        inertia: float,
        place: tuple[float, float, float],
        rate: tuple[float, float, float] = (0, 0, 0),
    ) -> int:
        """Add a body: kg, kg m^2, start (m, m, rad) of its center of mass with its rates; return its number."""
        self.masses.append(mass)
        self.inertias.append(inertia)
        self.start += place
        self.rates += rate
        return len(self.masses) - 1

    def place(self, x: Array, point: Point) -> tuple[Array, Array, Array]:
        """Return the position of a point (2,), its Jacobian (2, 3 n) and its arm (2,) from the center of mass."""
        body, (a, b) = point
        J = np.zeros((2, len(x)))
        if body == GROUND_NUMBER:
            return np.array((a, b)), J, np.zeros(2)
        c, s = np.cos(x[3 * body + 2]), np.sin(x[3 * body + 2])
        arm = np.array((c * a - s * b, s * a + c * b))
        J[:, 3 * body : 3 * body + 2] = np.eye(2)
        J[:, 3 * body + 2] = -arm[1], arm[0]
        return x[3 * body : 3 * body + 2] + arm, J, arm

    def constraints(self, x: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return gaps (m,), Jacobian (m, 3 n) and -J' v (m,)."""
        gaps, rows, bias = [], [], []

        def centripetal(point: Point, arm: Array) -> Array:
            return np.zeros(2) if point[0] == GROUND_NUMBER else -arm * v[3 * point[0] + 2] ** 2

        for a, b in self.pins:
            (p, J, arm), (q, K, other) = self.place(x, a), self.place(x, b)
            gaps.append(p - q)
            rows.append(J - K)
            bias.append(centripetal(b, other) - centripetal(a, arm))
        for point, normal, offset in self.guides:
            p, J, arm = self.place(x, point)
            gaps.append(np.array([p @ np.array(normal) - offset]))
            rows.append((np.array(normal) @ J)[None])
            bias.append(np.array([-centripetal(point, arm) @ np.array(normal)]))
        return np.concatenate(gaps), np.vstack(rows), np.concatenate(bias)

    def forces(self, x: Array) -> Array:
        """Return the generalized forces (3 n,)."""
        f = np.zeros(len(x))
        f[1::3] = -self.gravity * np.array(self.masses)
        for body, torque in self.torques:
            f[3 * body + 2] += torque
        for a, b, stiffness, free in self.springs:
            (p, J, _), (q, K, _) = self.place(x, a), self.place(x, b)
            f -= stiffness * (1.0 - free / np.hypot(*(p - q))) * (p - q) @ (J - K)
        return f

    @property
    def mass_matrix(self) -> Array:
        """Diagonal of the mass matrix (3 n,)."""
        return np.column_stack((self.masses, self.masses, self.inertias)).ravel()

    def rate(self, _: Any, y: Array) -> Array:
        """Return velocities and accelerations (6 n,)."""
        x, v = np.split(y, 2)
        _, J, bias = self.constraints(x, v)
        inverse = 1.0 / self.mass_matrix
        free = inverse * self.forces(x)
        multipliers = np.linalg.lstsq((J * inverse) @ J.T, bias - J @ free, rcond=None)[0]
        return np.concatenate((v, free + inverse * (J.T @ multipliers)))

    def project(self, x: Array, v: Array) -> tuple[Array, Array]:
        """Return the nearest positions and velocities that satisfy the constraints."""
        for _ in range(NEWTON_ITERATIONS):
            gaps, J, _ = self.constraints(x, v)
            x = x - np.linalg.lstsq(J, gaps, rcond=None)[0]
        _, J, _ = self.constraints(x, v)
        return x, v - np.linalg.lstsq(J, J @ v, rcond=None)[0]

    def motion(self, times: Any, nudge: float = 0.0, rtol: float = RTOL) -> tuple[Array, Array]:
        """Return positions and velocities (k, 3 n) at times (k,), s; with a nudge they are changed at each of them."""
        rng = np.random.default_rng(len(times))
        x, v = self.project(np.array(self.start, float), np.array(self.rates, float))
        change = nudge * np.tile((self.size, self.size, 1.0), len(self.masses))
        found = [(x, v)]
        for span in pairwise(np.asarray(times, float)):
            if nudge:
                x = x + change * rng.choice((-1.0, 1.0), len(x))
                v = v + self.rate_size * change * rng.choice((-1.0, 1.0), len(v))
                x, v = self.project(x, v)
            part = solve_ivp(self.rate, span, np.concatenate((x, v)), method="DOP853", rtol=rtol, atol=rtol)
            x, v = self.project(*np.split(part.y[:, -1], 2))
            found.append((x, v))
        return np.array([x for x, _ in found]), np.array([v for _, v in found])

    def reference(self, select: Callable[[Any, Any], Array], stop_time: float) -> Pushed:
        """Return the motion as a reference of the quantities that ``select`` returns."""
        times = np.linspace(0.0, stop_time, 11)
        difference = np.abs(select(*self.motion(times)) - select(*self.motion(times, rtol=COARSE_RTOL))).max()
        return Pushed(self.motion, select, float(difference))
