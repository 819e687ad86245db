"""Planar linkages with closed loops."""

from __future__ import annotations

from functools import cache
from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Mechanism, Revolute, RevoluteCutJoint, Spring, rod
from mbfmu.verification.mechanisms.case import Case, G
from mbfmu.verification.mechanisms.planar import SQUEEZER_END, n_four_bar, slider_crank, squeezer
from mbfmu.verification.planar_bodies import GROUND_NUMBER, PlanarBodies
from mbfmu.verification.problem import NUDGE, Motion, Reference
from mbfmu.verification.references import Pushed

from .sources import IFTOMM, IVP_TEST_SET

Array = NDArray[np.float64]


def first_angle(case: Case) -> Mechanism:
    """Return the mechanism of a case with the first joint angle as an output."""
    m = case.mechanism
    m.output("angle", m.bodies[1].angle(), "Angle of the first body")
    return m


def first_coordinate(case: Case) -> Pushed:
    """Return the exact motion of a case as a reference of its first coordinate."""
    assert case.exact is not None
    return Pushed(case.exact, lambda q, _: q[:, :1], 1e-10)


class EndAngles:
    """Published angles of the squeezing mechanism at the end; their sensitivity is that of absolute coordinates."""

    uncertainty = 1e-13

    def at(self, times: Array) -> Reference:
        """Return the reference at times (k,), s; its values are those of the last time."""
        x, _ = squeezer_bodies().motion(times)
        pushed, _ = squeezer_bodies().motion(times, nudge=NUDGE)
        k1, k2, k3, k5, k4, k7, k6 = (pushed - x)[:, 2::3].T / NUDGE
        change = np.column_stack((k1, k2 - k1, k3, k5, k4 - k5, k7, k6 - k7))
        sensitivity = np.maximum.accumulate(np.abs(change))
        return Reference(np.broadcast_to(SQUEEZER_END, sensitivity.shape), sensitivity, self.uncertainty)


@cache
def squeezer_bodies() -> PlanarBodies:
    """Return the seven bodies in absolute coordinates; data of the IVP test set."""
    bodies = PlanarBodies(gravity=0.0, size=0.03, rate_size=1e3)
    A, B, phi = (-0.06934, -0.00227), (-0.03635, 0.03273), 0.222668390165885884674473185609
    beta, gamma = -0.0617138900142764496358948458001, 0.455279819163070380255912382449
    delta, epsilon = 0.487364979543842550225598953530, 1.23054744454982119249735015568

    def add(pivot: Any, angle: float, mass: float, inertia: float, com: Array) -> int:
        c, s = cos(angle), sin(angle)
        place = (pivot[0] + c * com[0] - s * com[1], pivot[1] + s * com[0] + c * com[1], angle)
        return bodies.add(mass, inertia, place)

    coms = np.array(
        (
            (0.00092, 0.0),
            (-0.0115, 0.0),
            (0.01043, -0.01874),
            (0.02308, 0.00916),
            (0.0, -0.00579),
            (-0.00449, -0.01228),
            (0.00579, 0.0),
        )
    )
    pin = (0.007 * cos(beta), 0.007 * sin(beta))
    k1 = add((0.0, 0.0), beta, 0.04325, 2.194e-6, coms[0])
    k2 = add(pin, beta, 0.00365, 4.410e-7, coms[1])
    k3 = add(B, gamma, 0.02373, 5.255e-6, coms[2])
    k5 = add(A, delta, 0.07050, 1.169e-5, coms[3])
    elbow = (A[0] + 0.04 * cos(delta), A[1] + 0.04 * sin(delta))
    k4 = add(elbow, delta + phi, 0.00706, 5.667e-7, coms[4])
    k7 = add(A, epsilon, 0.05498, 1.912e-5, coms[5])
    knee = (A[0] + 0.04 * sin(epsilon), A[1] - 0.04 * cos(epsilon))
    k6 = add(knee, epsilon - phi, 0.00706, 5.667e-7, coms[6])

    def point(body: int, x: float, y: float) -> Any:
        return body, (x - coms[body, 0], y - coms[body, 1])

    tip = point(k2, -0.028, 0.0)
    for body, pivot in ((k1, (0.0, 0.0)), (k3, B), (k5, A), (k7, A)):
        bodies.pins.append((point(body, 0.0, 0.0), (GROUND_NUMBER, pivot)))
    bodies.pins += [
        (point(k2, 0.0, 0.0), point(k1, 0.007, 0.0)),
        (point(k4, 0.0, 0.0), point(k5, 0.04, 0.0)),
        (point(k6, 0.0, 0.0), point(k7, 0.0, -0.04)),
        (point(k3, 0.0, -0.035), tip),
        (point(k4, 0.0, -0.02), tip),
        (point(k6, 0.02, 0.0), tip),
    ]
    bodies.springs.append((point(k3, 0.02, -0.018), (GROUND_NUMBER, (0.014, 0.072)), 4530.0, 0.07785))
    bodies.torques.append((k1, 0.033))
    return bodies


def measured_squeezer() -> Mechanism:
    """Return the squeezing mechanism with the joint angles of its bodies, in the order of the published values."""
    m = squeezer().mechanism
    for body in m.bodies[1:]:
        m.output(body.name, body.angle(), f"Angle of {body.name}, relative to the body before it")
    return m


LENGTHS, MASSES, START, RATE = (1.0, 2.5, 2.0, 3.5 - 0.5), (1.0, 2.5, 2.0), 1.2, -2.0  # m, kg, rad, rad/s
SPRING, FREE = 60.0, 1.2  # N/m, m


def closed(start: float) -> tuple[float, float]:
    """Return the absolute angles of coupler and rocker of the four-bar for an angle of the crank."""
    a, b, c, d = LENGTHS
    x, y = d - a * cos(start), -a * sin(start)
    reach = np.hypot(x, y)
    coupler = np.arctan2(y, x) + np.arccos((b * b + reach**2 - c * c) / (2.0 * b * reach))
    return float(coupler), float(np.arctan2(b * sin(coupler) - y, b * cos(coupler) - x))


def sprung_four_bar() -> Mechanism:
    """Return a four-bar with a spring from the crank pin to the pivot of the rocker."""
    a, b, c, d = LENGTHS
    coupler_angle, rocker_angle = closed(START)
    m = Mechanism(gravity=(0.0, -G, 0.0))
    joint = Revolute(start=START, rate=RATE, fixed=True)
    crank = m.body("crank", m.ground, joint, **rod(mass=MASSES[0], length=a))
    pin = Revolute(at=(a, 0.0, 0.0), start=coupler_angle - START)
    coupler = m.body("coupler", crank, pin, **rod(mass=MASSES[1], length=b))
    foot = Revolute(at=(d, 0.0, 0.0), start=rocker_angle)
    rocker = m.body("rocker", m.ground, foot, **rod(mass=MASSES[2], length=c))
    m.cut("pin", RevoluteCutJoint(at_a=(b, 0.0, 0.0), at_b=(c, 0.0, 0.0)), coupler, rocker)
    spring = Spring(stiffness=SPRING, free=FREE, at_a=(a, 0.0, 0.0), at_b=(d, 0.0, 0.0))
    m.force("spring", spring, crank, m.ground)
    m.output("crank", crank.angle(), "Angle of the crank")
    m.output("rocker", rocker.angle(), "Angle of the rocker")
    m.output("energy", m.energy, "Total energy")
    return m


def sprung_four_bar_exact() -> Pushed:
    """Return the motion in absolute coordinates."""
    a, b, c, d = LENGTHS
    coupler, rocker = closed(START)
    pin = np.array((a * cos(START), a * sin(START)))
    end = np.array((d + c * cos(rocker), c * sin(rocker)))
    rates = np.linalg.solve(
        ((-b * sin(coupler), c * sin(rocker)), (b * cos(coupler), -c * cos(rocker))),
        RATE * np.array((pin[1], -pin[0])),
    )
    speed = RATE * np.array((-pin[1], pin[0]))
    bodies = PlanarBodies(gravity=G, size=1.0, rate_size=3.0)

    def bar(mass: float, length: float, near: Any, far: Any, angle: float, velocity: Any, rate: float) -> int:
        place, moved = 0.5 * (np.array(near) + far), 0.5 * np.array(velocity)
        return bodies.add(mass, mass * length**2 / 12.0, (*place, angle), (*moved, rate))

    k1 = bar(MASSES[0], a, (0.0, 0.0), pin, START, speed, RATE)
    tip = rates[1] * np.array((-c * sin(rocker), c * cos(rocker)))
    k2 = bar(MASSES[1], b, pin, end, coupler, speed + tip, rates[0])
    k3 = bar(MASSES[2], c, (d, 0.0), end, rocker, tip, rates[1])
    bodies.pins += [
        ((k1, (-0.5 * a, 0.0)), (GROUND_NUMBER, (0.0, 0.0))), ((k2, (-0.5 * b, 0.0)), (k1, (0.5 * a, 0.0))),
        ((k3, (-0.5 * c, 0.0)), (GROUND_NUMBER, (d, 0.0))), ((k3, (0.5 * c, 0.0)), (k2, (0.5 * b, 0.0))),
    ]  # fmt: skip
    bodies.springs.append(((k1, (0.5 * a, 0.0)), (GROUND_NUMBER, (d, 0.0)), SPRING, FREE))
    return bodies.reference(lambda x, _: x[:, (2, 8)], 5.0)


PLANAR_LOOP_PROBLEMS = (
    Motion(
        name="A02 two four-bars",
        description="Two four-bars in a row with links of 1 m and 1 kg, top at 1 m/s, 10 s. When all links are "
        "horizontal, both loops are singular at the same time.",
        sources=(IFTOMM,),
        quantity="Angle of the first column",
        unit="rad",
        derivation="SciPy DOP853 on the equation of one degree of freedom",
        build=lambda: first_angle(n_four_bar(2)),
        outputs=("angle",),
        exact=lambda: first_coordinate(n_four_bar(2)),
        stop_time=10.0,
    ),
    Motion(
        name="A02 forty four-bars",
        description="Forty four-bars in a row with links of 1 m and 1 kg, top at 1 m/s, 10 s.",
        sources=(IFTOMM,),
        quantity="Angle of the first column",
        unit="rad",
        derivation="SciPy DOP853 on the equation of one degree of freedom",
        build=lambda: first_angle(n_four_bar(40)),
        outputs=("angle",),
        exact=lambda: first_coordinate(n_four_bar(40)),
        stop_time=10.0,
        solvers=("adams", "ida"),
        is_quick=False,
    ),
    Motion(
        name="A03 squeezer",
        description="Andrews' squeezing mechanism: seven bodies, three loops, a spring and a constant torque, 0.03 s.",
        sources=(IFTOMM, IVP_TEST_SET),
        quantity="Joint angles of the seven bodies at the end",
        unit="rad",
        derivation="published values of 16 digits",
        build=measured_squeezer,
        outputs=("K1", "K2", "K3", "K5", "K4", "K7", "K6"),
        exact=EndAngles,
        stop_time=0.03,
        only_end=True,
    ),
    Motion(
        name="sprung four-bar",
        description="Four-bar with links of 1, 2.5 and 2 m (1, 2.5 and 2 kg) on a base of 3 m, and a spring of 60 N/m "
        "with a free length of 1.2 m between the crank pin and the pivot of the rocker, 5 s.",
        quantity="Angles of crank and rocker",
        unit="rad",
        derivation="SciPy DOP853 in absolute coordinates",
        build=sprung_four_bar,
        outputs=("crank", "rocker"),
        exact=sprung_four_bar_exact,
        stop_time=5.0,
    ),
    Motion(
        name="slider-crank",
        description="Crank of 1 kg and rod of 0.5 kg, both of 1 m, slider of 0.8 kg, 3 s. The slider passes the center "
        "of the crank in a singular configuration.",
        quantity="Angle of the crank",
        unit="rad",
        derivation="SciPy DOP853 on the equation of one degree of freedom",
        build=lambda: first_angle(slider_crank()),
        outputs=("angle",),
        exact=lambda: first_coordinate(slider_crank()),
        stop_time=3.0,
    ),
)
