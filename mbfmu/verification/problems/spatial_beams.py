"""Beams with large deflection and torsion in three dimensions, as chains of nodal bodies with beam elements."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from math import cos, pi, radians, sin

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import root

from mbfmu.mechanics import BeamElement, Body, Floating, Mechanism, PointForce, Weld
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.verification.problem import Source, Value

Array = NDArray[np.float64]
ELEMENTS = 16
MESH_ERROR = 5e-4  # relative to the largest coordinate, of results extrapolated from two meshes


@dataclass(frozen=True)
class Rod:
    """Clamped circular or straight rod with a dead load at its free end.

    Attributes
    ----------
    length
        Length along the axis, m.
    stiffness
        E A, N; G I_t and E I for deflections along y and along z, N m^2.
    load
        Components of the load, N; the rod starts along x.
    curvature
        Curvature without load, towards y, 1/m.
    """

    length: float
    stiffness: tuple[float, float, float, float]
    load: tuple[float, float, float]
    curvature: float = 0.0


def rod_chain(rod: Rod, elements: int = ELEMENTS) -> Mechanism:
    """Return nodes with six coordinates each, connected by elements along the chords of the rod."""
    m = Mechanism()
    angle = rod.curvature * rod.length / elements
    chord = 2.0 * sin(0.5 * angle) / rod.curvature if rod.curvature else rod.length / elements
    axial, torsion, bending_y, bending_z = rod.stiffness
    node: Body = m.body("node[0]", m.ground, Weld())
    for i in range(1, elements + 1):
        turn = angle if i > 1 else 0.5 * angle  # from chord to chord; the first one begins at the tangent
        rotation = np.array(((cos(turn), -sin(turn), 0.0), (sin(turn), cos(turn), 0.0), (0.0, 0.0, 1.0)))
        frame = m.body(f"frame[{i}]", node, Weld(rotation=rotation))
        joint = Floating(start=(chord, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
        node = m.body(f"node[{i}]", frame, joint, mass=1.0, inertia=(1.0, 1.0, 1.0))  # without effect on the result
        stiffness = {"axial": axial, "torsion": torsion, "bending_y": bending_y, "bending_z": bending_z}
        m.force(f"element[{i}]", BeamElement(length=chord, **stiffness), frame, node)
    for axis, magnitude in zip("xyz", rod.load, strict=True):
        m.force(f"load.{axis}", PointForce(magnitude=magnitude, axis=axis), node)
        m.output(axis, node.position(axis), f"Coordinate {axis} of the tip")
    return m


def refined_tip(rod: Rod, m: Mechanism) -> Array:
    """Return the coordinates of the tip, m, extrapolated from two meshes (Richardson)."""
    coarse, fine = (equilibrium(found).outputs for found in (rod_chain(rod, ELEMENTS // 2), m))
    return np.array([(4.0 * fine[axis] - coarse[axis]) / 3.0 for axis in "xyz"])


LOAD_STEPS = 8


@cache
def rod_tip(rod: Rod) -> Array:
    """Return the coordinates of the tip, m, by shooting for the moment at the clamp.

    With the rotation R of the cross-section, the load F and the moment M, both in global axes:
    r' = (1 + R_1 F / E A) R_1, R' = R [k x], k = K^-1 R^T M + k_0, M' = -r' x F, and M = 0 at the tip (rod of Kirchhoff
    with stretch). S. S. Antman (2005): Nonlinear problems of elasticity, 2nd edition, Springer, chapter 8.
    """
    axial, torsion, bending_y, bending_z = rod.stiffness
    compliance, natural = 1.0 / np.array((torsion, bending_z, bending_y)), np.array((0.0, 0.0, rod.curvature))

    def slope(force: Array, arc_length: float, y: Array) -> Array:
        R, M = y[3:12].reshape(3, 3), y[12:]
        k = compliance * (R.T @ M) + natural
        tangent = (1.0 + R[:, 0] @ force / axial) * R[:, 0]
        return np.concatenate((tangent, np.cross(R, k).ravel(), -np.cross(tangent, force)))

    def end(force: Array, moment: Array) -> Array:
        start = np.concatenate((np.zeros(3), np.eye(3).ravel(), moment))
        solved = solve_ivp(
            partial(slope, force), (0.0, rod.length), start, method="DOP853", rtol=1e-11, atol=1e-11 * rod.length
        )
        return np.asarray(solved.y[:, -1])

    unit = rod.length * float(np.linalg.norm(rod.load))

    def residual(moment: Array, part: float) -> Array:
        return end(part * np.array(rod.load), moment)[12:] / unit

    moment = np.zeros(3)
    for part in np.linspace(0.0, 1.0, LOAD_STEPS + 1)[1:]:
        moment = root(residual, moment, args=(part,), tol=1e-11).x
    return end(np.array(rod.load), moment)[:3]


BEND = Rod(
    length=25.0 * pi, stiffness=(1e7, 5e6 / 6.0, 1e7 / 12.0, 1e7 / 12.0), load=(0.0, 0.0, 600.0), curvature=0.01
)  # published for inches and pounds

PRINCETON_SIDES, PRINCETON_LENGTH = (12.377e-3, 3.2024e-3), 0.508  # m
PRINCETON_YOUNG, PRINCETON_SHEAR, PRINCETON_LOADS = 71.7e9, 27.37e9, (4.448, 8.896, 13.345)  # Pa, Pa, N


def princeton_rod(load: float, angle: float) -> Rod:
    """Return the beam of the Princeton experiment; the load is at an angle, degrees, to its stiff side (y)."""
    wide, thin = PRINCETON_SIDES
    area, stiff, soft = wide * thin, thin * wide**3 / 12.0, wide * thin**3 / 12.0
    torsion = wide * thin**3 * (1.0 / 3.0 - 0.21 * thin / wide * (1.0 - (thin / wide) ** 4 / 12.0))  # Roark
    turned = radians(angle)
    return Rod(
        length=PRINCETON_LENGTH,
        stiffness=(
            PRINCETON_YOUNG * area,
            PRINCETON_SHEAR * torsion,
            PRINCETON_YOUNG * stiff,
            PRINCETON_YOUNG * soft,
        ),
        load=(0.0, load * cos(turned), load * sin(turned)),
    )


BATHE = Source(
    "K.-J. Bathe, S. Bolourchi",
    1979,
    "Large displacement analysis of three-dimensional beam structures. International Journal for Numerical Methods in "
    "Engineering 14, 961-986",
    "https://doi.org/10.1002/nme.1620140703",
)
DOWELL = Source(
    "E. H. Dowell, J. J. Traybar",
    1975,
    "An experimental study of the nonlinear stiffness of a rotor blade undergoing flap, lag, and twist deformations. "
    "Princeton University, AMS report 1194",
)
BAUCHAU = Source(
    "O. A. Bauchau, P. Betsch, A. Cardona, J. Gerstmayr, B. Jonker, P. Masarati, V. Sonneville",
    2016,
    "Validation of flexible multibody dynamics beam formulations using benchmark problems. Multibody System Dynamics "
    "37, 29-48",
    "https://doi.org/10.1007/s11044-016-9514-y",
)

SPATIAL_BEAM_PROBLEMS = (
    Value(
        name="bend of 45 degrees",
        description="Circular cantilever with a radius of 100, an angle of 45 degrees, a square section of side 1 and "
        f"E = 1e7 (inches, pounds), {ELEMENTS} beam elements, with a load of 600 perpendicular to its plane.",
        sources=(BATHE,),
        quantity="Coordinates of the tip",
        unit="in",
        derivation="rod of Kirchhoff, by shooting with SciPy",
        build=partial(rod_chain, BEND),
        measure=partial(refined_tip, BEND),
        method="equilibrium",
        reference=partial(rod_tip, BEND),
        uncertainty=1e-8,
        allowed=MESH_ERROR,
    ),
    *(
        Value(
            name=f"Princeton beam, {load:g} N",
            description="Cantilever of aluminum, 508 x 12.377 x 3.2024 mm, with a load at its tip at 45 degrees to its "
            f"sides, {ELEMENTS} beam elements; without weight.",
            sources=(DOWELL, BAUCHAU),
            quantity="Coordinates of the tip",
            unit="m",
            derivation="rod of Kirchhoff, by shooting with SciPy",
            build=partial(rod_chain, princeton_rod(load, 45.0)),
            measure=partial(refined_tip, princeton_rod(load, 45.0)),
            method="equilibrium",
            reference=partial(rod_tip, princeton_rod(load, 45.0)),
            uncertainty=1e-8,
            allowed=MESH_ERROR,
            is_quick=load == PRINCETON_LOADS[-1],
        )
        for load in PRINCETON_LOADS
    ),
)
