"""Car axis of the IVP test set, and the stiff flyball governor of the IFToMM library."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Mechanism, Revolute, Spring, Translational
from mbfmu.verification.mechanisms.case import G
from mbfmu.verification.problem import NUDGE, Exact, Motion, Reference, Source
from mbfmu.verification.references import integrated

from .sources import IFTOMM, IVP_TEST_SET

Array = NDArray[np.float64]

AXIS_MASS, AXIS_EPSILON, AXIS_LENGTH, AXIS_FREE = 10.0, 1e-2, 1.0, 0.5
BUMP, BUMP_RATE, AXIS_GRAVITY, AXIS_END = 0.1, 10.0, 1.0, 3.0
# Positions xl, yl, xr, yr at t = 3
CAR_AXIS_END = (0.0493455784275402809122, 0.496989460230171153861, 1.04174252488542151681, 0.373911027265361256927)


def car_axis() -> Mechanism:
    """Return the car axis: two wheels, of which the right one follows the road, springs, and a chassis of two masses.

    The left mass is on the line that is normal to the axle at the left wheel, and a rod connects both masses.
    """
    half, stiffness = 0.5 * AXIS_MASS, 1.0 / AXIS_EPSILON**2
    m = Mechanism(gravity=(0.0, -AXIS_GRAVITY, 0.0))
    road = f"arcsin({BUMP} * sin({BUMP_RATE} * t))"
    axle = m.body("axle", m.ground, Revolute(drive=road))
    left = m.body("left", axle, Translational(axis="y", start=AXIS_FREE, fixed=True), mass=half)
    turn = BUMP * BUMP_RATE  # rad/s, of the axle at the start; the rod does not turn
    right = m.body("right", left, Revolute(rate=-turn, fixed=True), mass=half, com=(AXIS_LENGTH, 0.0, 0.0))
    end = (AXIS_LENGTH, 0.0, 0.0)
    m.force("spring_left", Spring(stiffness=stiffness, free=AXIS_FREE), left, m.ground)
    m.force("spring_right", Spring(stiffness=stiffness, free=AXIS_FREE, at_a=end, at_b=end), right, axle)
    for name, body, point in (("l", left, (0.0, 0.0, 0.0)), ("r", right, end)):
        for axis in "xy":
            m.output(f"{axis}{name}", body.position(axis, point), f"Coordinate {axis} of a mass")
    return m


def car_axis_right(t: float, y: Array) -> Any:
    """Return the rates of (angle of the rod, distance of the left mass from the wheel) and of their rates.

    Lagrange's equations in these coordinates, with the motion of the axle prescribed.
    """
    psi, s, dpsi, ds = y
    u, du, ddu = (
        BUMP * f for f in (sin(BUMP_RATE * t), BUMP_RATE * cos(BUMP_RATE * t), -(BUMP_RATE**2) * sin(BUMP_RATE * t))
    )
    root = np.sqrt(1.0 - u * u)
    phi, dphi = np.arcsin(u), du / root
    ddphi = ddu / root + u * du * du / root**3
    across, along = np.array((-sin(phi), cos(phi))), np.array((cos(phi), sin(phi)))
    rod, normal = np.array((cos(psi), sin(psi))), np.array((-sin(psi), cos(psi)))
    stiffness, half = 1.0 / AXIS_EPSILON**2, 0.5 * AXIS_MASS
    left, right = s * across, s * across + AXIS_LENGTH * rod
    pull = [(p, np.hypot(*p)) for p in (left, right - AXIS_LENGTH * along)]
    forces = [-stiffness * (1.0 - AXIS_FREE / r) * p - half * AXIS_GRAVITY * np.array((0.0, 1.0)) for p, r in pull]
    # acceleration of the left mass without s'', and of the right mass relative to it without psi''
    known = -2.0 * ds * dphi * along - s * ddphi * along - s * dphi**2 * across
    turned = known - AXIS_LENGTH * dpsi**2 * rod
    arm = AXIS_LENGTH * normal
    M = half * np.array(((arm @ arm, arm @ across), (arm @ across, 2.0 * across @ across)))
    f = np.array(
        (
            arm @ (forces[1] - half * turned),
            across @ (forces[0] + forces[1] - half * (known + turned)),
        )
    )
    ddpsi, dds = np.linalg.solve(M, f)
    return dpsi, ds, ddpsi, dds


class CarAxisEnd:
    """Published positions at the end, with the sensitivity of Lagrange's equations to changes at every output time."""

    uncertainty = 1e-12

    def at(self, times: Array) -> Reference:
        """Return the reference at times (k,), s; its values are those of the last time."""
        start = np.array((0.0, AXIS_FREE, 0.0, 0.0))

        def positions(nudge: float) -> Array:
            rng, y, found = np.random.default_rng(len(times)), start, []
            for begin, end in pairwise(times):
                y = y + nudge * np.array((1.0, 1.0, BUMP_RATE, BUMP_RATE)) * rng.choice((-1.0, 1.0), 4)
                y = solve_ivp(car_axis_right, (begin, end), y, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
                phi = np.arcsin(BUMP * sin(BUMP_RATE * end))
                left = y[1] * np.array((-sin(phi), cos(phi)))
                found.append((*left, *(left + AXIS_LENGTH * np.array((cos(y[0]), sin(y[0]))))))
            return np.array(found)

        change = np.abs(positions(NUDGE) - positions(0.0)) / NUDGE
        sensitivity = np.maximum.accumulate(np.vstack((change[:1], change)))
        return Reference(np.broadcast_to(CAR_AXIS_END, sensitivity.shape), sensitivity, self.uncertainty)


DENSITY, ARM_LENGTH, WIDTH, SLIDER_SIZE = 3000.0, 1.0, 0.01, 0.1  # kg/m^3, m, m, m
BALL, GOVERNOR_STIFFNESS, GOVERNOR_DAMPING, FREE_LENGTH = 5.0, 8e5, 4e4, 0.5  # kg, N/m, N s/m, m
OPENING, DISTANCE, SPINDLE_RATE = radians(30.0), 0.5, 2.0 * pi  # rad below the horizontal, m below the hinges, rad/s
ARM_MASS, SLIDER_MASS = DENSITY * ARM_LENGTH * WIDTH**2, DENSITY * SLIDER_SIZE**3
INERTIA_ACROSS, INERTIA_ALONG = ARM_MASS * (ARM_LENGTH**2 + WIDTH**2) / 12.0, ARM_MASS * WIDTH**2 / 6.0
SLIDER_INERTIA = SLIDER_MASS * SLIDER_SIZE**2 / 6.0


def governor() -> Mechanism:
    """Return a free spindle along y with two arms, balls at their ends, and a slider on two spring-dampers."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    spindle = m.body(
        "spindle",
        m.ground,
        Revolute(axis="y", rate=SPINDLE_RATE),
        mass=ARM_MASS,
        inertia=(INERTIA_ACROSS, INERTIA_ALONG, INERTIA_ACROSS),
    )
    joint = Translational(axis=(0.0, -1.0, 0.0), start=DISTANCE)
    slider = m.body("slider", spindle, joint, mass=SLIDER_MASS, inertia=(SLIDER_INERTIA,) * 3)
    middle = 0.5 * ARM_LENGTH
    for name, side in (("left", -1.0), ("right", 1.0)):
        hinge = Revolute(axis=(0.0, 0.0, -side), start=OPENING)
        mass = ARM_MASS + BALL
        center = (ARM_MASS * middle + BALL * ARM_LENGTH) / mass
        across = INERTIA_ACROSS + ARM_MASS * (center - middle) ** 2 + BALL * (ARM_LENGTH - center) ** 2
        arm = m.body(
            name, spindle, hinge, mass=mass, com=(side * center, 0.0, 0.0), inertia=(INERTIA_ALONG, across, across)
        )
        spring = Spring(
            stiffness=GOVERNOR_STIFFNESS, damping=GOVERNOR_DAMPING, free=FREE_LENGTH, at_a=(side * middle, 0.0, 0.0)
        )
        m.force(f"{name}.spring", spring, arm, slider)
    m.output("s", slider.coordinate(), "Distance of the slider below the hinges")
    return m


def governor_exact() -> Exact:
    """Return the symmetric motion by Lagrange's equations of the angle of the arms, the slider and the spindle.

    The momentum about the vertical, I(a) w, is constant.
    """
    middle, load = 0.5 * ARM_LENGTH, ARM_MASS * 0.25 * ARM_LENGTH**2 + INERTIA_ACROSS
    swing = load + BALL * ARM_LENGTH**2
    weight = G * (ARM_MASS * middle + BALL * ARM_LENGTH)

    def turning(a: float) -> tuple[float, float]:
        """Return the moment of inertia about the vertical, and its derivative."""
        c, s, spread = cos(a), sin(a), swing - INERTIA_ALONG
        return INERTIA_ALONG + SLIDER_INERTIA + 2.0 * (INERTIA_ALONG + spread * c * c), -4.0 * spread * c * s

    def right(_: float, y: Array) -> Any:
        a, x, da, dx, w = y
        c, s = cos(a), sin(a)
        across, down = middle * c, x - middle * s
        length = np.hypot(across, down)
        by_a, by_x = (-across * middle * s - down * middle * c) / length, down / length
        force = GOVERNOR_STIFFNESS * (length - FREE_LENGTH) + GOVERNOR_DAMPING * (by_a * da + by_x * dx)
        inertia, slope = turning(a)
        dda = (0.25 * slope * w * w + weight * c - force * by_a) / swing
        return da, dx, dda, G - 2.0 * force * by_x / SLIDER_MASS, -slope * da * w / inertia

    start = (OPENING, DISTANCE, 0.0, 0.0, SPINDLE_RATE)
    scales = (1.0, 1.0, SPINDLE_RATE, SPINDLE_RATE, SPINDLE_RATE)
    return integrated(right, start, scales, lambda _, y: (y[1],), 10.0, method="Radau")


PUBLISHED_PROBLEMS = (
    Motion(
        name="car axis",
        description="Two masses on springs at the ends of an axle, whose right wheel moves on a wavy road, 3 s.",
        sources=(IVP_TEST_SET,),
        quantity="Positions of both masses at the end",
        unit="m",
        derivation="published values of 18 digits",
        build=car_axis,
        outputs=("xl", "yl", "xr", "yr"),
        exact=CarAxisEnd,
        stop_time=AXIS_END,
        only_end=True,
    ),
    Motion(
        name="A05 governor",
        description="Stiff flyball governor: free spindle at 2 pi rad/s, arms of 1 m at 30 degrees below the "
        "horizontal with balls of 5 kg, slider of 3 kg on two spring-dampers of 8e5 N/m and 4e4 N s/m, 10 s.",
        sources=(
            IFTOMM,
            Source(
                "Rehabilitation Engineering Group",
                2016,
                "MBS benchmarks in OpenSim: A05 stiff flyball governor (data)",
                "http://rehabenggroup.github.io/MBSbenchmarksInOpenSim/",
            ),
        ),
        quantity="Distance of the slider below the hinges",
        unit="m",
        derivation="SciPy Radau on Lagrange's equations",
        build=governor,
        outputs=("s",),
        exact=governor_exact,
        stop_time=10.0,
        solvers=("radau", "ida"),
        is_quick=False,
    ),
)
