"""Friction of a sheet that sticks, along curves: a bristle that is drawn along an arc, and a block in the plane."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Harmonic, Mechanism, PointForce
from mbfmu.sheets.contact.sliding import draw_bristle
from solvers.compiled.kernel import kernel

from .test_sheet_stick import CREEP, DEFLECTION, LENGTH, SLIDES, on_table, run

TOLERANCE = 1e-5


def draw(e: Any, moved: Any, velocity: Any, taken: float) -> Any:
    """The kernel, with numbers that are complex."""
    found = draw_bristle(*((complex(a[0]), complex(a[1])) for a in (e, moved, velocity)), taken)
    return np.array(found)


def unit(angle: float) -> Any:
    return np.array((np.cos(angle), np.sin(angle)))


def lag_on_arc(angle: float, length: float, turn: float) -> Any:
    """Angle of a fully deflected bristle by SciPy, along an arc whose direction goes from -turn to turn."""
    rate = lambda s, phi: np.sin(-turn + 2.0 * turn * s / length - phi)  # noqa: E731
    return solve_ivp(rate, (0.0, length), [angle], method="LSODA", rtol=1e-11, atol=1e-12).y[0, -1]


@pytest.mark.parametrize("length", [1e-3, 0.3, 3.0, 30.0, 3e4])
@pytest.mark.parametrize("angle", [-3.0, -1.2, 0.1, 1.4, 2.5])
def test_a_bristle_follows_on_a_tractrix_along_a_line(angle: float, length: float) -> None:
    """tan(phi / 2) = tan(phi_0 / 2) exp(-s / d), after a chord through the circle if it is drawn inwards."""
    e, direction = unit(angle), 0.7
    free = max(0.0, -2.0 * e[0])
    expected = e + np.array((length, 0.0))
    if length > free:
        start = angle if free == 0.0 else np.sign(angle) * np.pi - angle
        expected = unit(2.0 * np.arctan(np.tan(0.5 * start) * np.exp(free - length)))
    turned = np.array(((np.cos(direction), -np.sin(direction)), (np.sin(direction), np.cos(direction))))
    found = draw(turned @ e, length * turned[:, 0], turned[:, 0], length)
    np.testing.assert_allclose(turned.T @ found.real, expected, atol=1e-12)


@pytest.mark.parametrize("length", [0.03, 1.0, 5.0, 40.0, 1e3])
def test_the_error_along_an_arc_is_of_the_second_order_in_the_turn(length: float) -> None:
    """Of paths that are short and long compared with the deflection."""
    for turn in (0.1, 0.01, 0.001):
        for angle in (-1.0, 0.2, 1.3):
            chord = length * np.sin(turn) / turn
            found = draw(unit(angle), (chord, 0.0), unit(turn), length).real
            assert np.linalg.norm(found) == pytest.approx(1.0)
            expected = unit(lag_on_arc(angle, length, turn))
            np.testing.assert_allclose(found, expected, atol=0.5 * turn**2)


@pytest.mark.parametrize("seed", range(5))
def test_the_derivatives_of_the_deflection_are_those_by_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    e = unit(rng.uniform(-3.0, 3.0)) * rng.choice((0.4, 1.0))
    values = np.array((*(unit(0.2) * 10.0 ** rng.uniform(0.4, 1.5)), *(unit(0.4) * rng.uniform(0.5, 2.0))))

    def evaluate(x: Any) -> Any:
        (a, b, c, d), taken = (complex(value) for value in x), 3.0
        return np.array(draw_bristle((complex(e[0]), complex(e[1])), (a, b), (c, d), taken))

    for k in range(4):
        h = np.eye(4)[k]
        exact, differences = evaluate(values + 1e-30j * h).imag / 1e-30, evaluate(values + 1e-6 * h)
        differences = (differences - evaluate(values - 1e-6 * h)).real / 2e-6
        np.testing.assert_allclose(exact, differences, atol=1e-7)


@kernel
def push(loads: Any, t: float) -> complex:
    """Acceleration (m/s^2) at t (s) along x, and along z as imaginary part."""
    x = loads[0, 0] * np.sin(2.0 * np.pi * loads[0, 1] * t + loads[0, 2]) + loads[0, 3]
    z = loads[1, 0] * np.sin(2.0 * np.pi * loads[1, 1] * t + loads[1, 2]) + loads[1, 3]
    return complex(x, z)


@kernel
def block_in_plane(loads: Any, law: Any, h: float, steps: int, found: Any) -> None:
    """Put displacements (m) of a block under accelerations that oscillate into ``found``, those along z as imaginary
    parts. It has an elastic, perfectly plastic bristle: Heun's method with ``steps`` of h (s) between two times.

    ``loads`` (2, 4): amplitude (m/s^2), frequency (Hz), phase (rad) and constant part along x and z; ``law``: sliding
    acceleration (m/s^2), deflection (m), velocity of the damping (m/s).
    """
    slides, d, damping = law[0], law[1], law[2]
    x, v, e = 0.0j, 0.0j, 0.0j
    for k in range((len(found) - 1) * steps):
        u = e / d + v / damping
        a = push(loads, k * h) - slides * u / max(1.0, abs(u))
        w = v + h * a
        e += 0.5 * h * (v + w)
        e /= max(1.0, abs(e) / d)
        u = e / d + w / damping
        end = v + 0.5 * h * (a + push(loads, (k + 1) * h) - slides * u / max(1.0, abs(u)))
        x, v = x + 0.5 * h * (v + end), end
        if (k + 1) % steps == 0:
            found[(k + 1) // steps] = x


def drawn_in_plane(loads: Any, **options: Any) -> Mechanism:
    """The block on a table under these loads along x and z."""
    m = on_table(**options)
    for node in (node for row in m.meshes[0].nodes for node in row):
        for axis, (amplitude, frequency, phase, constant) in zip("xz", loads, strict=True):
            load = Harmonic(amplitude=amplitude * node.mass, frequency=frequency, phase=phase)
            m.force(f"{axis}.{node.name}", PointForce(magnitude=load, axis=axis), node)
            m.force(f"{axis}0.{node.name}", PointForce(magnitude=constant * node.mass, axis=axis), node)
    return m


@pytest.mark.parametrize(("solver", "limit"), [("esdirk", 30.0), ("radau", 10.0)])
def test_a_block_that_sticks_and_slides_along_curves(solver: str, limit: float) -> None:
    """Errors in tolerances. With bristles that turn with the chords of the steps they were up to 340 and 270."""
    rng, law = np.random.default_rng(11), np.array((SLIDES, DEFLECTION, CREEP))
    for _ in range(4):
        amplitudes, phases, constants = (
            SLIDES * rng.uniform(0.5, 2.5, 2),
            rng.uniform(0.0, 6.3, 2),
            rng.uniform(-1, 1, 2),
        )
        loads = np.column_stack((amplitudes, (1.0, 0.5), phases, constants))
        found = run(drawn_in_plane(loads), 2.0, 0.05, solver, tolerance=TOLERANCE)
        expected = np.zeros(41, complex)
        block_in_plane(loads, law, 0.05 / 20000, 20000, expected)
        for axis, motion in (("x", expected.real), ("z", expected.imag)):
            np.testing.assert_allclose(found[axis] - found[axis][0], motion, atol=limit * TOLERANCE * LENGTH)
