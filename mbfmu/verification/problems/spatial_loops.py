"""Spatial linkages: Bricard, Bennett, Sarrus, RSSR, Cardan shafts, platform on six legs."""

from __future__ import annotations

from math import cos, radians, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import DistanceCutJoint, Floating, Mechanism, Polynomial, Revolute, Spring, UniversalCutJoint
from mbfmu.verification.mechanisms.case import G, turning
from mbfmu.verification.mechanisms.spatial import COMPLEX_DIFFERENCE_STEP, bennett, bricard, sarrus
from mbfmu.verification.problem import Exact, Motion, Source
from mbfmu.verification.references import Pushed, closed_form, integrated

from .planar_loops import first_angle, first_coordinate
from .sources import IFTOMM

Array = NDArray[np.float64]
CUBE_CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]], float
)  # of the unit cube
CUBE_RODS = np.roll(CUBE_CORNERS, -1, axis=0) - CUBE_CORNERS


def rotation(axis: Array, angle: Any) -> Any:
    """Return the matrix of a rotation about a unit axis; the angle may be complex."""
    x, y, z = axis
    K = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def bricard_second(x: Any) -> Any:
    """Return the angle of the even hinges for that of the odd ones.

    Both differ by a right angle from the angles of the threefold-symmetric Bricard linkage with twists of 90 degrees,
    for which cos a + cos b + cos a cos b = 0.
    """
    return np.arcsin(-np.sin(x) / (1.0 - np.sin(x)))


def bricard_exact() -> Pushed:
    """Return the motion of one degree of freedom with energies by forward kinematics."""

    def at_unit_rate(x: Any) -> tuple[Any, Any]:
        s = np.sin(x)
        y = bricard_second(x)
        ratio = -np.cos(x) / ((1.0 - s) ** 2 * np.cos(y))  # dy/dx
        R, o = np.eye(3, dtype=complex), np.zeros(3, complex)
        v, w, kinetic, potential = np.zeros(3, complex), np.zeros(3, complex), 0.0j, 0.0j
        for i in range(5):
            axis = np.cross(CUBE_RODS[i - 1], CUBE_RODS[i])
            angle, rate = (x, 1.0) if i % 2 == 0 else (y, ratio)
            w = w + R @ axis * rate
            R = R @ rotation(axis, angle)
            half = 0.5 * R @ CUBE_RODS[i]
            moved = v + np.cross(w, half)
            across = w - R @ CUBE_RODS[i] * (w @ (R @ CUBE_RODS[i]))
            kinetic += moved @ moved + across @ across / 12.0
            potential += G * (o + half)[1]
            v, o = v + 2.0 * np.cross(w, half), o + 2.0 * half
        return kinetic, potential

    def inertia(x: float) -> tuple[float, float]:
        value = at_unit_rate(x + 1j * COMPLEX_DIFFERENCE_STEP)[0]
        return value.real, value.imag / COMPLEX_DIFFERENCE_STEP

    def slope(x: float) -> float:
        return float(at_unit_rate(x + 1j * COMPLEX_DIFFERENCE_STEP)[1].imag / COMPLEX_DIFFERENCE_STEP)

    rate_size = sqrt(G)

    def motion(times: Any, nudge: float = 0.0) -> tuple[Any, Any]:
        return turning(inertia, slope, (0.0, 0.0), lambda a, b: (a[:, None], b[:, None]), rate_size=rate_size)(
            times, nudge
        )

    return Pushed(motion, lambda q, _: q, 1e-10)


CRANK, COUPLER, ROCKER, PIVOT, CRANK_SPEED = 0.5, 2.0, 1.2, (1.5, 0.3, 1.0), 3.0  # m, m, m, m, rad/s


def rocker_angle(crank: Any) -> Any:
    """Return the angle of the rocker of the RSSR linkage for an angle of the crank."""
    wx, wy, wz = PIVOT[0] - CRANK * np.cos(crank), PIVOT[1] - CRANK * np.sin(crank), PIVOT[2]
    right = (COUPLER**2 - ROCKER**2 - (wx * wx + wy * wy + wz * wz)) / (2.0 * ROCKER)
    return np.arctan2(-wz, wx) + np.arccos(right / np.hypot(wx, wz))


def rssr() -> Mechanism:
    """Return a crank about z that moves a rocker about y by a rod with two ball joints."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    crank = m.body("crank", m.ground, Revolute(drive=Polynomial((0.0, CRANK_SPEED))), mass=1.0, inertia=(0.1,) * 3)
    joint = Revolute(axis="y", at=PIVOT, start=float(rocker_angle(0.0)))
    rocker = m.body("rocker", m.ground, joint, mass=2.0, com=(0.5 * ROCKER, 0.0, 0.0), inertia=(0.1, 0.3, 0.3))
    cut = DistanceCutJoint(at_a=(CRANK, 0.0, 0.0), at_b=(ROCKER, 0.0, 0.0), length=COUPLER)
    m.cut("rod", cut, crank, rocker)
    m.output("rocker", rocker.angle(), "Angle of the rocker")
    return m


def rssr_exact() -> Exact:
    """Return the angle of the rocker in closed form."""

    def solution(start: Array, times: Array) -> Array:
        return np.asarray(rocker_angle(start[0] + CRANK_SPEED * times))[:, None]

    return closed_form(solution, (0.0,), (1.0,), 10.0)


BENDS, SHAFT_SPEED = (radians(30.0), radians(20.0)), 4.0  # rad, rad/s


def about_z(angle: float) -> Array:
    """Return the matrix of a rotation about z."""
    c, s = cos(angle), sin(angle)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))


def shafts() -> Mechanism:
    """Return three shafts in a plane that two Cardan joints connect; the first one is driven."""
    m = Mechanism()
    first = m.body("first", m.ground, Revolute(axis="x", drive=Polynomial((0.0, SHAFT_SPEED))), inertia=(0.1,) * 3)
    second_frame, third_frame = about_z(BENDS[0]), about_z(BENDS[0] + BENDS[1])
    center = tuple(second_frame[:, 0])
    second = m.body("second", m.ground, Revolute(axis="x", rotation=second_frame), inertia=(0.1,) * 3)
    third = m.body("third", m.ground, Revolute(axis="x", at=center, rotation=third_frame), inertia=(0.2,) * 3)
    m.cut("cross1", UniversalCutJoint(axis="y", second="z"), first, second)
    m.cut("cross2", UniversalCutJoint(at_a=(1.0, 0.0, 0.0), axis="z", second="y"), second, third)
    m.output("second", second.angle(), "Angle of the second shaft")
    m.output("third", third.angle(), "Angle of the third shaft")
    return m


def shafts_exact() -> Exact:
    """Return tan a2 = tan a1 / cos b1 and tan a3 = tan a2 cos b2."""

    def solution(start: Array, times: Array) -> Array:
        angle = start[0] + SHAFT_SPEED * times
        s, c = np.sin(angle), np.cos(angle)
        second, third = np.arctan2(s, cos(BENDS[0]) * c), np.arctan2(cos(BENDS[1]) * s, cos(BENDS[0]) * c)
        return np.unwrap(np.column_stack((second, third)), axis=0)

    return closed_form(solution, (0.0,), (1.0,), 100.0)


PLATE_MASS, PLATE_INERTIA = 20.0, np.array((1.0, 1.2, 2.0))  # kg, kg m^2
LEG_STIFFNESS, LEG_LENGTH = 8e3, 1.1  # N/m, m
FEET = [(cos(a), sin(a), 0.0) for a in np.radians((-10.0, 10.0, 110.0, 130.0, 230.0, 250.0))]
TOPS = [(0.6 * cos(a), 0.6 * sin(a), 0.0) for a in np.radians((-50.0, 50.0, 70.0, 170.0, 190.0, 290.0))]
PLATE_START, PLATE_RATE = (0.05, 0.0, 1.0), (0.3, -0.2, 0.0, 0.5, -0.4, 0.8)  # m; m/s and rad/s


def platform() -> Mechanism:
    """Return a plate on six elastic legs without mass; gravity along -z."""
    m = Mechanism(gravity=(0.0, 0.0, -G))
    joint = Floating(start=(*PLATE_START, 1.0, 0.0, 0.0, 0.0), rate=PLATE_RATE)
    plate = m.body("plate", m.ground, joint, mass=PLATE_MASS, inertia=tuple(PLATE_INERTIA))
    for k, (foot, top) in enumerate(zip(FEET, TOPS, strict=True)):
        m.force(f"leg{k}", Spring(stiffness=LEG_STIFFNESS, free=LEG_LENGTH, at_a=top, at_b=foot), plate, m.ground)
    for axis in "xyz":
        m.output(axis, plate.position(axis, (0.6, 0.0, 0.0)), f"Coordinate {axis} of a point of the platform")
    m.output("energy", m.energy, "Total energy")
    return m


def platform_exact() -> Exact:
    """Return the motion by the equations of Newton and Euler with a quaternion."""
    feet, tops = np.array(FEET), np.array(TOPS)

    def matrix(q: Array) -> Any:
        w, x, y, z = q / np.sqrt(np.sum(q * q, axis=0))
        return np.array(
            (
                (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
                (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
                (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
            )
        )

    def right(_: float, y: Array) -> Array:
        r, q, v, w = y[:3], y[3:7], y[7:10], y[10:]
        R = matrix(q)
        legs = r + tops @ R.T - feet
        lengths = np.linalg.norm(legs, axis=1)
        forces = -LEG_STIFFNESS * (1.0 - LEG_LENGTH / lengths)[:, None] * legs
        moment = np.cross(tops, forces @ R).sum(axis=0)
        turn = 0.5 * np.append(-q[1:] @ w, q[0] * w + np.cross(q[1:], w))
        acceleration = forces.sum(axis=0) / PLATE_MASS - (0.0, 0.0, G)
        return np.concatenate((v, turn, acceleration, (moment - np.cross(w, PLATE_INERTIA * w)) / PLATE_INERTIA))

    def output(_: Array, y: Array) -> Any:
        return y[:3] + 0.6 * matrix(y[3:7])[:, 0]

    start = (*PLATE_START, 1.0, 0.0, 0.0, 0.0, *PLATE_RATE)
    return integrated(right, start, (1.0,) * 7 + (10.0,) * 6, output, 2.0)


SPATIAL_LOOP_PROBLEMS = (
    Motion(
        name="A04 Bricard",
        description="Six rods of 1 m and 1 kg along edges of a cube, one of them fixed, released from rest, 5 s. One "
        "of five constraint equations is redundant.",
        sources=(
            IFTOMM,
            Source(
                "Y. Chen, Z. You, T. Tarnai",
                2005,
                "Threefold-symmetric Bricard linkages for deployable structures. International Journal of Solids and "
                "Structures 42, 2287-2301",
                "https://doi.org/10.1016/j.ijsolstr.2004.09.014",
            ),
        ),
        quantity="Angle of the first hinge",
        unit="rad",
        derivation="SciPy DOP853 on the equation of one degree of freedom, loop in closed form",
        build=lambda: first_angle(bricard()),
        outputs=("angle",),
        exact=bricard_exact,
        stop_time=5.0,
    ),
    Motion(
        name="Bennett linkage",
        description="Bennett's linkage with twists of 40 and 70 degrees, released at 60 degrees, 5 s. Five constraint "
        "equations on three coordinates have the rank two.",
        quantity="Angle of the first hinge",
        unit="rad",
        derivation="SciPy DOP853 on the equation of one degree of freedom, loop in closed form",
        build=lambda: first_angle(bennett()),
        outputs=("angle",),
        exact=lambda: first_coordinate(bennett()),
        stop_time=5.0,
    ),
    Motion(
        name="Sarrus linkage",
        description="Plate guided by two folding legs, released at 60 degrees, 0.3 s. Five constraint equations on "
        "five coordinates have the rank four.",
        quantity="Angle of a lower link",
        unit="rad",
        derivation="SciPy DOP853 on the equation of one degree of freedom",
        build=lambda: first_angle(sarrus(start=60.0, stop_time=0.3)),
        outputs=("angle",),
        exact=lambda: first_coordinate(sarrus(start=60.0, stop_time=0.3)),
        stop_time=0.3,
        is_quick=False,
    ),
    Motion(
        name="RSSR linkage",
        description="Crank of 0.5 m about z at 3 rad/s moves a rocker of 1.2 m about y by a rod of 2 m, 5 s.",
        quantity="Angle of the rocker",
        unit="rad",
        derivation="closed form",
        build=rssr,
        outputs=("rocker",),
        exact=rssr_exact,
        stop_time=5.0,
    ),
    Motion(
        name="Cardan shafts",
        description="Three shafts in a plane with bends of 30 and 20 degrees and two Cardan joints, driven at 4 rad/s, "
        "5 s.",
        quantity="Angles of the second and the third shaft",
        unit="rad",
        derivation="closed form",
        build=shafts,
        outputs=("second", "third"),
        exact=shafts_exact,
        stop_time=5.0,
    ),
    Motion(
        name="Stewart platform",
        description="Platform of 20 kg on six elastic legs without mass (8000 N/m, free length 1.1 m), 2 s.",
        quantity="Position of a point of the platform",
        unit="m",
        derivation="SciPy DOP853 on the equations of Newton and Euler",
        build=platform,
        outputs=("x", "y", "z"),
        exact=platform_exact,
        stop_time=2.0,
    ),
)
