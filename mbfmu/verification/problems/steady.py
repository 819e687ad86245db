"""Steady states and eigenvalues: rod on a spindle, whirl, buckling, large deflection and rotation of a beam."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import ellipeinc, ellipkinc

from mbfmu.mechanics import (
    DistanceCutJoint,
    JointSpring,
    Mechanism,
    PointForce,
    Polynomial,
    Revolute,
    Translational,
    Weld,
    add_chain,
)
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.verification.mechanisms.case import G
from mbfmu.verification.problem import Source, Value

Array = NDArray[np.float64]

SPINDLE_SPEED, PENDULUM_LENGTH = 5.0, 0.8  # rad/s, m


def governor_pendulum() -> Mechanism:
    """Return a point mass on a rod whose hinge turns with a driven vertical spindle."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    spindle = m.body(
        "spindle", m.ground, Revolute(axis="y", drive=Polynomial((0.0, SPINDLE_SPEED))), inertia=(1.0, 1.0, 1.0)
    )
    m.body("ball", spindle, Revolute(start=1.0), mass=1.0, com=(0.0, -PENDULUM_LENGTH, 0.0))
    return m


def pendulum_state(m: Mechanism) -> Array:
    """Return the angle, rad, and the natural frequency, rad/s."""
    state = equilibrium(m)
    return np.array((state.positions()["ball"], state.modes[0].frequency))


def pendulum_reference() -> Array:
    """Return cos a = g / (w^2 l) and the frequency w sin a."""
    angle = np.arccos(G / (SPINDLE_SPEED**2 * PENDULUM_LENGTH))
    return np.array((angle, SPINDLE_SPEED * np.sin(angle)))


BALL_ARM, ROD_PIN, ROD = 0.3, 0.15, 0.2  # m: pivot to ball, pivot to rod on the arm, length of the rod
BALL_MASS, COLLAR_MASS, COLLAR_STIFFNESS, COLLAR_FREE, GOVERNOR_SPEED = 1.0, 1.5, 800.0, 0.25, 9.0  # SI units


def collar_distance(angle: Any) -> Any:
    """Return the distance of the collar below the pivot for an angle of the arms below the horizontal."""
    return ROD_PIN * np.sin(angle) + np.sqrt(ROD**2 - (ROD_PIN * np.cos(angle)) ** 2)


def rod_governor() -> Mechanism:
    """Return a governor with two arms, two rods and a sprung collar on a driven spindle."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    drive = Revolute(axis="y", drive=Polynomial((0.0, GOVERNOR_SPEED)))
    spindle = m.body("spindle", m.ground, drive, inertia=(1.0, 1.0, 1.0))
    start = Translational(axis=(0.0, -1.0, 0.0), start=float(collar_distance(0.8)))
    collar = m.body("collar", spindle, start, mass=COLLAR_MASS)
    for name, side in (("left", -1.0), ("right", 1.0)):
        hinge = Revolute(axis=(0.0, 0.0, -side), start=0.8)
        arm = m.body(name, spindle, hinge, mass=BALL_MASS, com=(side * BALL_ARM, 0.0, 0.0))
        m.cut(f"{name}.rod", DistanceCutJoint(at_a=(side * ROD_PIN, 0.0, 0.0), length=ROD), arm, collar)
    m.force("spring", JointSpring(stiffness=COLLAR_STIFFNESS, free=COLLAR_FREE), collar)
    return m


def rod_governor_state(m: Mechanism) -> Array:
    """Return the angle of the arms, rad, and the natural frequency, rad/s."""
    state = equilibrium(m)
    return np.array((state.positions()["left"], state.modes[0].frequency))


def rod_governor_reference() -> Array:
    """Return the stationary point of the potential in the rotating frame, and the frequency (V'' / I)^(1/2)."""

    def slope(angle: Any) -> Any:
        root = np.sqrt(ROD**2 - (ROD_PIN * np.cos(angle)) ** 2)
        lever = ROD_PIN * np.cos(angle) * (1.0 + ROD_PIN * np.sin(angle) / root)
        spring = COLLAR_STIFFNESS * (collar_distance(angle) - COLLAR_FREE) - G * COLLAR_MASS
        balls = (GOVERNOR_SPEED * BALL_ARM) ** 2 * np.sin(2.0 * angle) - 2.0 * G * BALL_ARM * np.cos(angle)
        return spring * lever + BALL_MASS * balls

    angle = brentq(slope, 0.2, 1.4, xtol=1e-15, rtol=1e-15)
    lever = collar_distance(angle + 1e-30j).imag / 1e-30
    inertia = 2.0 * BALL_MASS * BALL_ARM**2 + COLLAR_MASS * lever**2
    return np.array((angle, sqrt(slope(angle + 1e-30j).imag / 1e-30 / inertia)))


WHIRL_SPEED, STIFF = 7.0, (200.0, 90.0)  # rad/s, N/m along x and y of the rotor, 1 kg


def whirling() -> Mechanism:
    """Return a mass on two springs that turn with a driven shaft."""
    m = Mechanism()
    shaft = m.body("shaft", m.ground, Revolute(drive=Polynomial((0.0, WHIRL_SPEED))), inertia=(1.0, 1.0, 1.0))
    along = m.body("along", shaft, Translational(axis="x"))
    across = m.body("across", along, Translational(axis="y"), mass=1.0)
    m.force("x", JointSpring(stiffness=STIFF[0]), along)
    m.force("y", JointSpring(stiffness=STIFF[1]), across)
    return m


def frequencies(m: Mechanism, count: int) -> Array:
    """Return the lowest natural frequencies, rad/s."""
    return np.array([mode.frequency for mode in equilibrium(m).modes[:count]])


def lowest_frequency(m: Mechanism) -> Array:
    """Return the lowest natural frequency, rad/s."""
    return frequencies(m, 1)


def whirl_reference() -> Array:
    """Return the roots of s^4 + (kx + ky + 2 w^2) s^2 + (kx - w^2)(ky - w^2) = 0."""
    w2, (kx, ky) = WHIRL_SPEED**2, STIFF
    half = 0.5 * (kx + ky + 2.0 * w2)
    root = sqrt(half * half - (kx - w2) * (ky - w2))
    return np.sqrt((half - root, half + root))


BEAM_BENDING, BEAM_AXIAL, BEAM_MASS, BEAM_ELEMENTS = 1.0, 1e5, 1.0, 20  # N m^2, N, kg; a beam of 1 m


def beam(m: Mechanism, parent: Any, joint: Any, elements: int = BEAM_ELEMENTS) -> Any:
    """Add a beam of 1 m; return its nodes."""
    return add_chain(
        m,
        "beam",
        parent,
        joint,
        length=1.0,
        mass=BEAM_MASS,
        axial=BEAM_AXIAL,
        bending_stiffness=BEAM_BENDING,
        elements=elements,
    )


TIP_LOADS = (1.0, 5.0)  # P L^2 / E I


def refined(build: Callable[[int], Mechanism], measure: Callable[[Mechanism], Array]) -> Callable[[Mechanism], Array]:
    """Return the measure of a mechanism without the error of the mesh of second order.

    It is extrapolated from meshes of 20 and 10 elements (Richardson).
    """
    return lambda m: (4.0 * measure(m) - measure(build(BEAM_ELEMENTS // 2))) / 3.0


def cantilever(load: float, elements: int = BEAM_ELEMENTS) -> Mechanism:
    """Return a cantilever with a dead load at its tip."""
    m = Mechanism()
    nodes = beam(m, m.ground, Weld(), elements)
    m.force("load", PointForce(magnitude=-load * BEAM_BENDING, axis="y"), nodes[-1])
    for axis in "xy":
        m.output(axis, nodes[-1].position(axis), f"Coordinate {axis} of the tip")
    return m


def tip(m: Mechanism) -> Array:
    """Return the coordinates of the tip, m."""
    outputs = equilibrium(m).outputs
    return np.array((outputs["x"], outputs["y"]))


def elastica_tip(load: float) -> Array:
    """Return the coordinates of the tip by elliptic integrals.

    With the slope t at the tip: sqrt(P) = K(k) - F(f, k), 2 k^2 = 1 + sin t, f = arcsin(1 / (k sqrt 2)), the tip is at
    x = sqrt(2 sin t / P) and y = -(1 - 2 (E(k) - E(f, k)) / sqrt(P)).
    """

    def parts(slope: float) -> tuple[float, float]:
        k2 = 0.5 * (1.0 + np.sin(slope))
        f = np.arcsin(1.0 / sqrt(2.0 * k2))
        return (
            float(ellipkinc(0.5 * pi, k2) - ellipkinc(f, k2)),
            float(ellipeinc(0.5 * pi, k2) - ellipeinc(f, k2)),
        )

    slope = brentq(lambda t: parts(t)[0] - sqrt(load), 1e-9, 0.5 * pi - 1e-9, xtol=1e-15, rtol=1e-15)
    return np.array((sqrt(2.0 * np.sin(slope) / load), 2.0 * parts(slope)[1] / sqrt(load) - 1.0))


BUCKLING_PARTS = (0.9, 0.95, 0.99)  # of the critical load, at which frequencies are computed


def buckling_load(m: Mechanism) -> Array:
    """Return the load of zero frequency, by a parabola through three squared frequencies, in pi^2 E I / 4 L^2."""
    extrapolated = []
    for elements in (BEAM_ELEMENTS // 2, BEAM_ELEMENTS):
        squares = [lowest_frequency(column(elements, part))[0] ** 2 for part in BUCKLING_PARTS]
        roots = np.roots(np.polyfit(BUCKLING_PARTS, squares, 2)).real
        extrapolated.append(roots[np.argmin(np.abs(roots - 1.0))])
    return np.array([(4.0 * extrapolated[1] - extrapolated[0]) / 3.0])


PRESSED = 0.6  # part of the critical load


def column(elements: int = BEAM_ELEMENTS, part: float = PRESSED) -> Mechanism:
    """Return a cantilever column with a compressive load at its tip, a part of the critical one."""
    m = Mechanism()
    nodes = beam(m, m.ground, Weld(), elements)
    m.force("load", PointForce(magnitude=-part * 0.25 * pi**2 * BEAM_BENDING, axis="x"), nodes[-1])
    return m


@cache
def polynomial_beam(thrust: float, speed: float) -> float:
    """Return the lowest natural frequency, rad/s, of a cantilever of 1 m by the method of Ritz.

    Parameters
    ----------
    thrust
        Compressive force at the tip in units of E I / L^2.
    speed
        Speed of rotation about an axis at the clamped end that is parallel to the deflection, rad/s.

    The shape functions are x^2 P_n(2 x - 1) with Legendre polynomials. With the tension N = m w^2 (1 - x^2) / 2 - P,
    the energies are E I w''^2, N w'^2 and m w^2.
    """
    nodes, weights = np.polynomial.legendre.leggauss(60)
    x, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    count = 14
    shapes = [np.polynomial.Polynomial((0.0, 0.0, 1.0)) * np.polynomial.Legendre.basis(n, (0.0, 1.0)).convert(
        kind=np.polynomial.Polynomial
    ) for n in range(count)]  # fmt: skip
    w0, w1, w2 = (np.array([f.deriv(k)(x) if k else f(x) for f in shapes]) for k in (0, 1, 2))
    tension = 0.5 * BEAM_MASS * speed**2 * (1.0 - x * x) - thrust * BEAM_BENDING
    K = BEAM_BENDING * (w2 * weights) @ w2.T + (w1 * weights * tension) @ w1.T
    M = BEAM_MASS * (w0 * weights) @ w0.T
    return float(np.sqrt(eigh(K, M, eigvals_only=True)[0]))


TURNING = (1.0, 4.0, 8.0)  # rad/s, that is in units of sqrt(E I / (m L^4))


def turning_beam(speed: float, elements: int = BEAM_ELEMENTS) -> Mechanism:
    """Return a cantilever that turns about the y axis, in which it deflects."""
    m = Mechanism()
    hub = m.body("hub", m.ground, Revolute(axis="y", drive=Polynomial((0.0, speed))), inertia=(1.0, 1.0, 1.0))
    beam(m, hub, Weld(), elements)
    return m


WRIGHT = Source(
    "A. D. Wright, C. E. Smith, R. W. Thresher, J. L. C. Wang",
    1982,
    "Vibration modes of centrifugally stiffened beams. Journal of Applied Mechanics 49, 197-202",
    "https://doi.org/10.1115/1.3161966",
)
BISSHOPP = Source(
    "K. E. Bisshopp, D. C. Drucker",
    1945,
    "Large deflection of cantilever beams. Quarterly of Applied Mathematics 3, 272-275",
    "https://doi.org/10.1090/qam/13360",
)
MESH_ERROR = 5e-4  # relative, of extrapolated meshes

STEADY_STATE_PROBLEMS = (
    Value(
        name="rod on a spindle",
        description="Point mass on a massless rod of 0.8 m, hinged to a vertical spindle that turns at 5 rad/s.",
        quantity="Steady angle and natural frequency",
        unit="rad, rad/s",
        derivation="closed form",
        build=governor_pendulum,
        measure=pendulum_state,
        method="equilibrium",
        reference=pendulum_reference,
    ),
    Value(
        name="governor with rods",
        description="Two arms of 0.3 m with balls of 1 kg on a spindle at 9 rad/s; rods of 0.2 m connect points at "
        "0.15 m on the arms to a collar of 1.5 kg on a spring of 800 N/m with a free length of 0.25 m.",
        quantity="Steady angle of the arms and natural frequency",
        unit="rad, rad/s",
        derivation="stationary potential, by SciPy",
        build=rod_governor,
        measure=rod_governor_state,
        method="equilibrium",
        reference=rod_governor_reference,
    ),
    Value(
        name="whirl",
        description="Mass of 1 kg on springs of 200 and 90 N/m that turn with a shaft at 7 rad/s.",
        quantity="Natural frequencies in the rotating frame",
        unit="rad/s",
        derivation="closed form",
        build=whirling,
        measure=lambda m: frequencies(m, 2),
        method="modes",
        reference=whirl_reference,
    ),
    *(
        Value(
            name=f"elastica, P L2/EI = {load:g}",
            description=f"Cantilever of {BEAM_ELEMENTS} beam elements with a dead load at its tip, P L^2 / E I = "
            f"{load:g}.",
            sources=(BISSHOPP,),
            quantity="Coordinates of the tip by the length",
            unit="1",
            derivation="closed form (elliptic integrals)",
            build=partial(cantilever, load),
            measure=refined(partial(cantilever, load), tip),
            method="equilibrium",
            reference=partial(elastica_tip, load),
            allowed=MESH_ERROR,
        )
        for load in TIP_LOADS
    ),
    Value(
        name="column under load",
        description=f"Cantilever column of {BEAM_ELEMENTS} beam elements at 0.6 of its critical load (Euler).",
        quantity="Lowest natural frequency",
        unit="rad/s",
        derivation="method of Ritz with 14 polynomials",
        build=column,
        measure=refined(column, lowest_frequency),
        method="modes",
        reference=lambda: np.array([polynomial_beam(PRESSED * 0.25 * pi**2, 0.0)]),
        uncertainty=1e-8,
        allowed=MESH_ERROR,
    ),
    Value(
        name="buckling",
        description=f"Critical load of a cantilever column of {BEAM_ELEMENTS} beam elements, from its frequencies "
        "under three loads (Euler).",
        quantity="Critical load by that of the closed form",
        unit="1",
        derivation="closed form, pi^2 E I / 4 L^2",
        build=column,
        measure=buckling_load,
        method="modes",
        reference=lambda: np.ones(1),
        allowed=MESH_ERROR,
    ),
    *(
        Value(
            name=f"rotating beam, {speed:g}",
            description=f"Cantilever of {BEAM_ELEMENTS} beam elements that turns about its clamped end at "
            f"{speed:g} sqrt(E I / m L^4) and deflects along the axis (Southwell).",
            sources=(WRIGHT,),
            quantity="Lowest natural frequency",
            unit="rad/s",
            derivation="method of Ritz with 14 polynomials",
            build=partial(turning_beam, speed),
            measure=refined(partial(turning_beam, speed), lowest_frequency),
            method="modes",
            reference=lambda speed=speed: np.array([polynomial_beam(0.0, speed)]),  # type: ignore[misc]
            uncertainty=1e-8,
            allowed=MESH_ERROR,
            is_quick=speed == 4.0,
        )
        for speed in TURNING
    ),
)
