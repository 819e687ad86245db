"""Dry friction with exact solutions in pieces.

mbfmu has an elastic bristle in place of Coulomb friction. After a reversal it moves by twice its deflection d before
the friction F has its new sign. The work that the friction lacks is at most 4 F d, so that the velocity after the
reversal is too large by at most sqrt(8 F d / m), and a body that accelerates with a from rest is early by at most
sqrt(4 d / a). These bounds are the errors of the model that the problems state.
"""

from __future__ import annotations

from math import cos, radians, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import JointFriction, JointSpring, Mechanism, Polynomial, Spring, Translational
from mbfmu.verification.mechanisms.case import G
from mbfmu.verification.problem import Exact, Motion, Source
from mbfmu.verification.references import closed_form

Array = NDArray[np.float64]
YIELDING_PART, YIELDING_DEFLECTIONS = 0.1, 5.0  # of the friction, and of the deflection, while the bristle yields
DEFLECTION = 1e-5  # m, of the bristle in place of Coulomb friction
FRICTION_SOLVERS = ("radau", "ida")

SLOPE, STICKING, SLIPPING, LAUNCH, BLOCK = radians(25.0), 0.6, 0.3, 3.0, 2.0  # rad, -, -, m/s, kg


def incline(coefficient: float) -> Mechanism:
    """Return a block that is launched up an incline with a coefficient of friction."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    joint = Translational(axis=(cos(SLOPE), sin(SLOPE), 0.0), rate=LAUNCH, nominal=1.0)
    block = m.body("block", m.ground, joint, mass=BLOCK)
    friction = JointFriction(coulomb=coefficient * BLOCK * G * cos(SLOPE), deflection=DEFLECTION)
    m.force("friction", friction, block)
    m.output("x", block.coordinate(), "Distance along the incline")
    return m


def incline_exact(coefficient: float) -> Exact:
    """Return the motion in two pieces: upward, then at rest or downward."""
    pull, drag = G * sin(SLOPE), coefficient * G * cos(SLOPE)

    def solution(start: Array, times: Array) -> Array:
        x, v = start
        end = v / (pull + drag)
        up, down = np.minimum(times, end), np.maximum(times - end, 0.0)
        return np.asarray(x + v * up - 0.5 * (pull + drag) * up**2 - 0.5 * max(pull - drag, 0.0) * down**2)[:, None]

    return closed_form(solution, (0.0, LAUNCH), (1.0, LAUNCH), 10.0)


def reversal_speed(friction: float) -> float:
    """Return the largest error of the velocity after a reversal, m/s; ``friction`` by the mass, m/s^2."""
    return sqrt(8.0 * friction * DEFLECTION)


def slipping_error() -> float:
    """Return the largest error of the position of the block that slides back, m."""
    drag = SLIPPING * G * cos(SLOPE)
    return reversal_speed(drag) * (SLIDE_TIME - LAUNCH / (G * sin(SLOPE) + drag))


SLIDE_TIME = 2.0  # s
SPRING_MASS, SPRING_STIFFNESS, SPRING_FRICTION, RELEASE = 1.0, 100.0, 4.4, 1.0  # kg, N/m, N, m


def rubbing() -> Mechanism:
    """Return a mass on a spring with Coulomb friction, released at rest."""
    m = Mechanism()
    block = m.body("block", m.ground, Translational(axis="x", start=RELEASE, nominal=1.0), mass=SPRING_MASS)
    m.force("spring", JointSpring(stiffness=SPRING_STIFFNESS), block)
    m.force("friction", JointFriction(coulomb=SPRING_FRICTION, deflection=DEFLECTION), block)
    m.output("x", block.coordinate(), "Displacement")
    return m


def rubbing_exact() -> Exact:
    """Return half periods of a harmonic motion about +F/k or -F/k, until the spring is weaker than the friction."""

    def solution(start: Array, times: Array) -> Array:
        w, band = sqrt(SPRING_STIFFNESS / SPRING_MASS), SPRING_FRICTION / SPRING_STIFFNESS
        x, values, begin = float(start[0]), np.empty(len(times)), 0.0
        values[:] = np.nan
        while abs(x) > band:
            center = np.copysign(band, x)
            inside = (times >= begin) & (times <= begin + np.pi / w)
            values[inside] = center + (x - center) * np.cos(w * (times[inside] - begin))
            x, begin = 2.0 * center - x, begin + np.pi / w
        values[times > begin] = x
        return values[:, None]

    return closed_form(solution, (RELEASE,), (1.0,), 10.0)


BELT_SPEED, BELT_FRICTION = 0.5, 10.0  # m/s, N


def belt() -> Mechanism:
    """Return a mass on a spring that a belt carries along until it slips."""
    m = Mechanism()
    belt = m.body("belt", m.ground, Translational(axis="x", drive=Polynomial((0.0, BELT_SPEED))), mass=1.0)
    block = m.body("block", belt, Translational(axis="x", nominal=1.0), mass=SPRING_MASS)
    spring = Spring(stiffness=SPRING_STIFFNESS, free=1.0, at_b=(-1.0, 0.0, 0.0))
    m.force("spring", spring, block, m.ground)
    m.force("friction", JointFriction(coulomb=BELT_FRICTION, deflection=DEFLECTION), block)
    m.output("x", block.position("x"), "Displacement of the mass")
    return m


def belt_exact() -> Exact:
    """Return v t while the mass sticks, then F/k + (v / w) sin w (t - t1), during three quarters of a period."""

    def solution(start: Array, times: Array) -> Array:
        w, band = sqrt(SPRING_STIFFNESS / SPRING_MASS), BELT_FRICTION / SPRING_STIFFNESS
        slip = times - (band - start[0]) / BELT_SPEED
        sliding = band + BELT_SPEED / w * np.sin(w * np.maximum(slip, 0.0))
        return np.asarray(np.where(slip < 0.0, start[0] + BELT_SPEED * times, sliding))[:, None]

    return closed_form(solution, (0.0,), (1.0,), 10.0)


def slipping_belt_error() -> float:
    """Return the largest error of the displacement of the mass on the belt, m.

    The bristle yields between 0.9 and 1 of the friction F, until the slip v w^2 t^3 / 6 is a few of its deflections.
    The friction is too small by at most F / 10 for this time.
    """
    w = sqrt(SPRING_STIFFNESS / SPRING_MASS)
    time = (6.0 * YIELDING_DEFLECTIONS * DEFLECTION / (BELT_SPEED * w * w)) ** (1.0 / 3.0)
    return float(YIELDING_PART * BELT_FRICTION / SPRING_MASS * time / w)


def rubbing_error() -> float:
    """Return the largest error of the displacement of the mass on a spring, m: delay of all reversals times speed."""
    band, w = SPRING_FRICTION / SPRING_STIFFNESS, sqrt(SPRING_STIFFNESS / SPRING_MASS)
    x, delay, largest = RELEASE, 0.0, 0.0
    while x - 2.0 * band > band:
        x -= 2.0 * band
        delay += sqrt(4.0 * DEFLECTION / (w * w * (x - band)))
        largest = max(largest, delay * w * x)
    return largest


FRICTION_PROBLEMS = (
    Motion(
        name="incline, sticking",
        description="Block of 2 kg, launched at 3 m/s up an incline of 25 degrees with a coefficient of friction of "
        "0.6, 2 s. It stops and sticks.",
        quantity="Distance along the incline",
        unit="m",
        derivation="exact in pieces",
        build=lambda: incline(STICKING),
        outputs=("x",),
        exact=lambda: incline_exact(STICKING),
        stop_time=SLIDE_TIME,
        solvers=FRICTION_SOLVERS,
        model_error=5.0 * DEFLECTION,
    ),
    Motion(
        name="incline, slipping",
        description="The same block with a coefficient of friction of 0.3, 2 s. It stops and slides back.",
        quantity="Distance along the incline",
        unit="m",
        derivation="exact in pieces",
        build=lambda: incline(SLIPPING),
        outputs=("x",),
        exact=lambda: incline_exact(SLIPPING),
        stop_time=SLIDE_TIME,
        solvers=FRICTION_SOLVERS,
        model_error=slipping_error(),
    ),
    Motion(
        name="oscillator with friction",
        description="Mass of 1 kg on a spring of 100 N/m with Coulomb friction of 4.4 N, released at 1 m, 4 s. "
        "Amplitudes decrease linearly; after eleven half periods it sticks.",
        sources=(
            Source(
                "H. Lorenz",
                1924,
                "Lehrbuch der technischen Physik, volume 1: Technische Mechanik starrer Gebilde. Springer, Berlin",
            ),
        ),
        quantity="Displacement",
        unit="m",
        derivation="exact in pieces",
        build=rubbing,
        outputs=("x",),
        exact=rubbing_exact,
        stop_time=4.0,
        solvers=FRICTION_SOLVERS,
        model_error=rubbing_error(),
    ),
    Motion(
        name="mass on a belt",
        description="Mass of 1 kg on a spring of 100 N/m that a belt at 0.5 m/s carries along by dry friction of 10 N, "
        "0.6 s. It sticks for 0.2 s and then slips.",
        quantity="Displacement",
        unit="m",
        derivation="exact in pieces",
        build=belt,
        outputs=("x",),
        exact=belt_exact,
        stop_time=0.6,
        solvers=FRICTION_SOLVERS,
        model_error=slipping_belt_error(),
    ),
)
