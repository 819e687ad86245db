"""The benchmark bicycle of Meijaard, Papadopoulos, Ruina and Schwab: four rigid bodies and wheels that do not slip.

Frames of the publication: x forward, y to the right, z down; the rear wheel touches the plane z = 0 at the origin. The
lean is positive to the right, as is the steer angle.
"""

from __future__ import annotations

from functools import partial
from math import cos, pi, sin

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import Mechanism, Revolute, RollingWheel, Translational
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.verification.mechanisms.case import G
from mbfmu.verification.problem import Exact, Motion, Problem, Source, Value

Array = NDArray[np.float64]

MEIJAARD = Source(
    "J. P. Meijaard, J. M. Papadopoulos, A. Ruina, A. L. Schwab",
    2007,
    "Linearized dynamics equations for the balance and steer of a bicycle: a benchmark and review. Proceedings of the "
    "Royal Society A 463, 1955-1982",
    "https://doi.org/10.1098/rspa.2007.1857",
)
WHEEL_BASE, TRAIL, TILT = 1.02, 0.08, pi / 10.0  # m, m, rad: table 1
REAR_RADIUS, FRONT_RADIUS = 0.3, 0.35  # m
# table 2: weave (real and imaginary part), capsize and castering, 1/s; at rest four real eigenvalues
AT_REST = (3.13164324790656, -3.13164324790656, 5.53094371765393, -5.53094371765393)
EIGENVALUES = {  # by the speed, m/s
    1.0: (3.52696170990070, 0.80774027519930, -3.13423125066578, -7.11008014637442),
    2.0: (2.68234517512745, 1.68066296590675, -3.07158645641514, -8.67387984831735),
    3.0: (1.70675605663975, 2.31582447384325, -2.63366137253667, -10.35101467245920),
    4.0: (0.41325331521125, 3.07910818603206, -1.42944427361326, -12.15861426576447),
    5.0: (-0.77534188219585, 4.46486771378823, -0.32286642900409, -14.07838969279822),
    6.0: (-1.52644486584142, 5.87673060598709, -0.00406690076970, -16.08537123098026),
    7.0: (-2.13875644258362, 7.19525913329805, 0.10268170574766, -18.15788466125262),
    8.0: (-2.69348683581097, 8.46037971396931, 0.14327879765713, -20.27940894394569),
    9.0: (-3.21675402252485, 9.69377351531791, 0.15790184030917, -22.43788559040858),
    10.0: (-3.72016840437287, 10.90681139476287, 0.16105338653172, -24.62459635017404),
}
STABLE_SPEEDS = (4.29238253634111, 6.02426201538837)  # m/s
# matrices of the linear equations M x'' + v C1 x' + (g K0 + v^2 K2) x = 0 of lean and steer, section 4 (d)
BICYCLE_M = np.array(((80.81722, 2.31941332208709), (2.31941332208709, 0.29784188199686)))
BICYCLE_K0 = np.array(((-80.95, -2.59951685249872), (-2.59951685249872, -0.80329488458618)))
BICYCLE_K2 = np.array(((0.0, 76.59734589573222), (0.0, 2.65431523794604)))
BICYCLE_C1 = np.array(((0.0, 33.86641391492494), (-0.85035641456978, 1.68540397397560)))
LEAN_RATE, RIDE_SPEED = 1e-2, 4.6  # rad/s, m/s: push of the ride


def bicycle(speed: float, lean_rate: float = 0.0) -> Mechanism:
    """Return the bicycle that runs straight along x at a speed (m/s), and leans over at a rate (rad/s)."""
    m = Mechanism(gravity=(0.0, 0.0, G))
    along = m.body("x", m.ground, Translational(axis="x", at=(0.0, 0.0, -REAR_RADIUS), rate=speed))
    across = m.body("y", along, Translational(axis="y"))
    height = m.body("z", across, Translational(axis="z"))
    yaw = m.body("yaw", height, Revolute(axis="z", rate=0.0))
    lean = m.body("lean", yaw, Revolute(axis="x", start=0.0, rate=lean_rate))
    frame = m.body(
        "frame",
        lean,
        Revolute(axis="y"),
        mass=85.0,
        com=(0.3, 0.0, -0.9 + REAR_RADIUS),
        inertia=((9.2, 0.0, 2.4), (0.0, 11.0, 0.0), (2.4, 0.0, 2.8)),
    )
    rear = m.body("rear wheel", frame, Revolute(axis="y"), mass=2.0, inertia=(0.0603, 0.12, 0.0603))
    on_ground = WHEEL_BASE + TRAIL  # where the steer axis meets the plane
    axis = (sin(TILT), 0.0, cos(TILT))
    fork = m.body(
        "fork",
        frame,
        Revolute(axis=axis, at=(on_ground, 0.0, REAR_RADIUS), start=0.0, rate=0.0),
        mass=4.0,
        com=(0.9 - on_ground, 0.0, -0.7),
        inertia=((0.05892, 0.0, -0.00756), (0.0, 0.06, 0.0), (-0.00756, 0.0, 0.00708)),
    )
    hub = (-TRAIL, 0.0, -FRONT_RADIUS)
    front = m.body("front wheel", fork, Revolute(axis="y", at=hub), mass=3.0, inertia=(0.1405, 0.28, 0.1405))
    up = (0.0, 0.0, -1.0)
    m.cut("rear contact", RollingWheel(radius=REAR_RADIUS, normal=up), m.ground, rear)
    m.cut("front contact", RollingWheel(radius=FRONT_RADIUS, normal=up), m.ground, front)
    m.output("lean", lean.coordinate(), "Lean angle of the rear frame")
    m.output("steer", fork.coordinate(), "Steer angle")
    m.output("speed", along.rate(), "Speed of the rear hub along x")
    m.output("energy", m.energy, "Total energy")
    return m


def lateral_eigenvalues(m: Mechanism) -> Array:
    """Return real and imaginary part of the weave, capsize and castering, or four real eigenvalues, 1/s."""
    values = equilibrium(m).spectrum.values
    moving = values[values != 0.0]
    real = np.sort(moving[moving.imag == 0.0].real)
    weave = moving[moving.imag > 0.0]
    if len(weave):
        return np.array((weave[0].real, weave[0].imag, real[-1], real[0]))
    return np.array(sorted(real, key=lambda s: (abs(s), -s)))


def stability_limit(number: int, low: float, high: float) -> float:
    """Return the speed between two others (m/s) at which a real part of :func:`lateral_eigenvalues` is zero."""
    return float(
        scipy.optimize.brentq(lambda speed: lateral_eigenvalues(bicycle(speed))[number], low, high, xtol=1e-13)
    )


def linear_ride(start: Array, times: Array) -> Array:
    """Return lean and steer (k, 2) after the lean rate ``start`` (1,), by the published linear equations."""
    K = G * BICYCLE_K0 + RIDE_SPEED**2 * BICYCLE_K2
    inverse = np.linalg.solve(BICYCLE_M, np.hstack((K, RIDE_SPEED * BICYCLE_C1)))
    A = np.vstack((np.hstack((np.zeros((2, 2)), np.eye(2))), -inverse))
    first = np.array((0.0, 0.0, start[0], 0.0))
    return np.array([scipy.linalg.expm(A * t) @ first for t in times])[:, :2]


def ride_exact() -> Exact:
    """Return the linear motion after the push; motions of this size differ from it by their third power."""
    return Exact(linear_ride, (LEAN_RATE,), (1.0,), LEAN_RATE**3)


LATERAL = "Eigenvalues of weave, capsize and castering"
BICYCLE = "Bicycle of four rigid bodies whose wheels roll without slip, data of table 1"
BICYCLE_PROBLEMS: tuple[Problem, ...] = (
    *(
        Value(
            name=f"bicycle, {speed:g} m/s",
            description=f"{BICYCLE}, which runs straight at {speed:g} m/s.",
            sources=(MEIJAARD,),
            quantity=LATERAL,
            unit="1/s",
            derivation="published values of 15 digits (table 2)",
            build=partial(bicycle, speed),
            measure=lateral_eigenvalues,
            method="modes",
            reference=lambda values=values: np.array(values),  # type: ignore[misc]
            uncertainty=1e-14,
            allowed=1e-12,
            is_quick=speed in (0.0, 5.0),
        )
        for speed, values in {0.0: AT_REST, **EIGENVALUES}.items()
    ),
    Value(
        name="bicycle, stable speeds",
        description=f"{BICYCLE}: speeds between which it is stable without a rider's control.",
        sources=(MEIJAARD,),
        quantity="Speeds of weave and of capsize",
        unit="m/s",
        derivation="published values of 15 digits",
        build=partial(bicycle, 5.0),
        measure=lambda _: np.array((stability_limit(0, 4.0, 4.6), stability_limit(2, 5.6, 6.4))),
        method="modes",
        reference=lambda: np.array(STABLE_SPEEDS),
        uncertainty=1e-14,
        allowed=1e-11,
        is_quick=False,
    ),
    Motion(
        name="bicycle, ride",
        description=f"{BICYCLE}, which runs at {RIDE_SPEED:g} m/s and is pushed to a lean rate of {LEAN_RATE:g} rad/s, "
        "2 s.",
        sources=(MEIJAARD,),
        quantity="Lean and steer angle",
        unit="rad",
        derivation="published linear equations, matrix exponential",
        build=partial(bicycle, RIDE_SPEED, LEAN_RATE),
        outputs=("lean", "steer"),
        exact=ride_exact,
        stop_time=2.0,
    ),
)
