"""Strips of paper in nips and guides, by the equation of the elastica.

Paper of 80 g/m^2 and 0.1 mm, E = 4 GPa, 30 mm wide, not contracting across. The stations of a nip stand at +-c = 0.5 mm
along the feed, which holds a strip as a clamp c/3 ahead of its middle does, one that turns by M / (k c^2).
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq, root
from scipy.special import ellipe, ellipk

import mbfmu as mb
from mbfmu.mechanics import Body, Mechanism, Revolute, Signal
from mbfmu.sheets import Guide, NipHandle, Sheet, add_contact, add_nip, add_sheet

LENGTH, WIDTH, THICKNESS, DENSITY, GRAVITY, RADIUS = 0.297, 0.03, 1e-4, 800.0, 9.81, 0.01
BENDING = 4e9 * THICKNESS**3 / 12.0  # N m
WEIGHT = DENSITY * THICKNESS * GRAVITY  # N/m^2
HALF, RUBBER = 0.5e-3, 8e5  # c, m; k, N/m
CLAMP = HALF / 3.0  # m, ahead of the middle of a nip
GIVES = WIDTH / (RUBBER * HALF**2)  # rad to a moment per width of 1 N


def add_strip(m: Mechanism, nodes: int, out: float, **options: Any) -> Sheet:
    """A strip along x, with ``out`` m of it beyond x = 0."""
    given = {
        "length": LENGTH, "width": WIDTH, "thickness": THICKNESS, "youngs_modulus": 4e9, "poisson": 0.0,
        "density": DENSITY, "grid": (nodes, 3), "tree": "master", "membrane": True, "damping": 5e-4,
    } | options  # fmt: skip
    return add_sheet(m, "strip", at=(out - given["length"], 0.0, -0.5 * given["width"]), **given)


def add_driven(
    m: Mechanism, name: str, sheet: Sheet, drive: Signal, x: float = 0.0, inertia: float = 1e-5, **options: Any
) -> tuple[NipHandle, Body]:
    """A nip at x, and its roller below."""
    axle = Revolute(at=(x, -RADIUS, 0.0), drive=drive)
    roller = m.body(f"{name}.roller", m.ground, axle, mass=0.1, inertia=(inertia, inertia, inertia))
    given = {"width": WIDTH, "force": 2.0, "contact": 2.0 * HALF, "stiffness": RUBBER, "creep": 0.0} | options
    return add_nip(m, name, sheet, roller, radius=RADIUS, at=(x, 0.0, 0.0), **given), roller


def add_channel(m: Mechanism, sheet: Sheet) -> None:
    """Guides behind x = 0, 20 um below the strip and 0.3 mm above it."""
    for name, y in (("below", -0.5 * THICKNESS - 1.02e-3), ("above", 0.5 * THICKNESS + 1.3e-3)):
        plate = Guide(start=(-0.5, y, 0.0), end=(-2e-3, y, 0.0), radius=1e-3, width=0.1)
        add_contact(m, name, sheet, plate, points=(6, 3), stiffness=2e6, depth=2e-5)


def run(
    m: Mechanism, stop_time: float, interval: float, tolerance: float = 1e-4, solver: str = "esdirk", **options: Any
) -> mb.Result:
    """A run that goes to its end."""
    found = mb.simulate(m, stop_time, interval=interval, solver=solver, tolerance=tolerance, **options)
    assert not found.failure
    return found


def hanging(length: float, clamp: float = CLAMP, gives: float = GIVES) -> tuple[float, float, float]:
    """Tip (m) of a strip of this length below a nip at x = 0; moment per width in the nip, N."""
    free = length - clamp

    def rates(s: Any, y: Any, load: float) -> Any:
        return y[1], load * (free - s) / BENDING * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])

    def ends(a: Any, b: Any) -> Any:
        return a[0] - gives * BENDING * a[1], b[1], a[2] - clamp, a[3]

    s = np.linspace(0.0, free, 50)
    y = np.array((0.0 * s, 0.0 * s, s, 0.0 * s))
    for load in np.linspace(0.2, 1.0, 5) * WEIGHT:
        found = solve_bvp(partial(rates, load=load), ends, s, y, tol=1e-9, max_nodes=20000)
        assert found.success
        s, y = found.x, found.y
    return y[2, -1], y[3, -1], -BENDING * y[1, 0]


def buckled(length: float, span: float) -> tuple[float, float, float]:
    """Height (m), thrust per width and moment per width (N/m, N) of an elastica clamped at both ends, which is longer
    than the span between them: four quarters, each from an inflection to where the slope is zero.
    """

    def excess(k: float) -> float:
        return 2.0 * ellipe(k * k) / ellipk(k * k) - 1.0 - span / length

    k = brentq(excess, 1e-9, 0.9, xtol=1e-14)
    rate = 4.0 * ellipk(k * k) / length
    height, thrust = 4.0 * k / rate, BENDING * rate**2
    return height, thrust, 0.5 * thrust * height


def sliding(share: float) -> float:
    """Slip in units of the creep under this share of the friction."""
    return share / math.sqrt(1.0 - share**2)


def carried(stations: Any, least: float, idler_friction: float = 0.3) -> Any:
    """Velocity (m/s) along x and z at the origin, and turning about y (rad/s), of a rigid sheet in nips: forces and
    their moment are zero.

    ``stations`` (k, 4): place x, z (m), angle of the feed from x towards z, surface speed; all press alike, friction 1.
    """
    x, z, angle, speed = np.asarray(stations, dtype=float).T
    c, s = np.cos(angle), np.sin(angle)

    def sums(u: Any, least: float) -> Any:
        vx, vz = u[0] + u[2] * z, u[1] - u[2] * x
        along, beside = vx * c + vz * s - speed, vz * c - vx * s
        size = np.sqrt(along**2 + beside**2 + least**2)
        fd, fe = along / size, (1.0 + idler_friction) * beside / size
        fx, fz = fd * c - fe * s, fd * s + fe * c
        return fx.sum(), fz.sum(), 10.0 * (z * fx - x * fz).sum()

    u = np.array((speed.mean(), 0.0, 0.0))
    for softer in np.geomspace(1e3, 1.0, 13):
        found = root(sums, u, (softer * least,), tol=1e-13)
        u = found.x
    assert np.abs(found.fun).max() < 1e-9
    return u
