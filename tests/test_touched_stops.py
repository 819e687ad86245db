"""Impacts on bodies that touch each other without a force, against the impact law in absolute coordinates.

The reference solves the linear complementarity problem of the impulses exactly, in rational numbers, by principal
pivoting with the least index (Murty, *Linear Complementarity, Linear and Nonlinear Programming*, 1988, section 4.1).
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation

from .test_events import SMALL, G
from .test_resting_stops import SIZES

Numbers = list[Fraction]
SEEDS = [pytest.param(seed, marks=() if seed < 12 else pytest.mark.campaign) for seed in range(300)]
TOLERANCE = 1e-7


def solve_exactly(A: list[Numbers], b: Numbers) -> Numbers:
    """Return x of A x = b, by elimination."""
    rows, n = [[*row, x] for row, x in zip(A, b, strict=True)], len(b)
    for c in range(n):
        pivot = next(r for r in range(c, n) if rows[r][c])
        rows[c], rows[pivot] = rows[pivot], rows[c]
        rows[c] = [x / rows[c][c] for x in rows[c]]
        for r in range(n):
            if r != c:
                factor = rows[r][c]
                rows[r] = [x - factor * y for x, y in zip(rows[r], rows[c], strict=True)]
    return [row[-1] for row in rows]


def solve_complementarity_exactly(A: list[Numbers], b: Numbers) -> Numbers:
    """Return p >= 0 with A p - b >= 0 and p (A p - b) = 0, for a positive definite A."""
    n, active = len(b), set[int]()
    while True:
        order = sorted(active)
        found = solve_exactly([[A[i][j] for j in order] for i in order], [b[i] for i in order])
        p = [Fraction(0)] * n
        for i, x in zip(order, found, strict=True):
            p[i] = x
        rest = [sum(a * x for a, x in zip(A[i], p, strict=True)) - b[i] for i in range(n)]
        wrong = next((i for i in range(n) if (p[i] < 0 if i in active else rest[i] < 0)), None)
        if wrong is None:
            return p
        active ^= {wrong}


def rates_after(masses: np.ndarray, rates: np.ndarray, restitutions: np.ndarray, has_floor: bool) -> np.ndarray:
    """Return the velocities (n,) after an impact of bodies that touch, one on the other; restitution k is below k."""
    n = len(masses)
    m, v, e = ([Fraction(float(x)) for x in given] for given in (masses, rates, restitutions))
    contacts = range(0 if has_floor else 1, n)
    G = [[Fraction((j == k) - (j == k - 1)) for j in range(n)] for k in contacts]
    leaving = [sum(g * x for g, x in zip(row, v, strict=True)) for row in G]
    b = [-x * (1 + e[k] if x < 0 else 1) for k, x in zip(contacts, leaving, strict=True)]
    A = [[sum(g * h / mass for g, h, mass in zip(row, other, m, strict=True)) for other in G] for row in G]
    p = solve_complementarity_exactly(A, b)
    return np.array([float(v[j] + sum(row[j] * x for row, x in zip(G, p, strict=True)) / m[j]) for j in range(n)])


def pile(
    masses: np.ndarray, restitutions: np.ndarray, size: float, is_relative: bool, gravity: float = G
) -> mb.Mechanism:
    """Return bodies that touch, one on the other, the lowest of them 0.5 size above the floor, without a force."""
    m = mb.Mechanism(gravity=(0.0, -gravity * size, 0.0))
    for k, (mass, e) in enumerate(zip(masses, restitutions, strict=True)):
        below = m.bodies[-1]
        joint = mb.Translational(axis="y", start=0.0 if k and is_relative else 0.5 * size, nominal=size)
        body = m.body(f"body{k}", below if is_relative else m.ground, joint, mass=float(mass) * size**3)
        gap = body.coordinate() if is_relative or not k else m.relative_position(body, below, "y")
        m.event(f"stop{k}", gap, direction="down", then=mb.Bounce(float(e)))
        m.output(f"gap{k}", gap)
        m.output(f"rate{k}", body.velocity("y"))
    return m


def outputs(simulation: Simulation, name: str, n: int) -> np.ndarray:
    values = dict(zip([v.name for v in simulation.variables], simulation.outputs(), strict=True))
    return np.array([values[f"{name}{k}"] for k in range(n)])


def draw(seed: int) -> tuple[np.ndarray, np.ndarray, float, bool, Settings]:
    """Return masses, restitutions, size, whether coordinates are relative, and settings."""
    rng = np.random.default_rng(seed)
    n, spread = int(rng.integers(2, 11)), (0.5, 1.0, 2.0)[seed % 3]
    restitutions = np.zeros(n) if seed % 5 == 0 else rng.uniform(0.0, 1.0, n)
    settings = Settings(solver=SMALL[seed % len(SMALL)], tolerance=TOLERANCE)
    return 10.0 ** rng.uniform(-spread, spread, n), restitutions, SIZES[seed % 3], seed % 2 == 0, settings


@pytest.mark.parametrize("seed", SEEDS)
def test_touching_bodies_hit_the_floor(seed: int) -> None:
    """The velocities just after the impact, and one event: that of the floor."""
    masses, e, size, is_relative, settings = draw(seed)
    simulation = Simulation(pile(masses, e, size, is_relative), settings)
    fall, later = np.sqrt(1.0 / G), 1e-6
    simulation.advance(fall + later)
    n = len(masses)
    expected = rates_after(masses, np.full(n, -G * fall), e, True) - (G * later if e[0] else 0.0)
    np.testing.assert_allclose(outputs(simulation, "rate", n) / size, expected, rtol=0.0, atol=10.0 * TOLERANCE)
    assert [event.name for event in simulation.events] == ["stop0"]


@pytest.mark.parametrize("seed", SEEDS)
def test_an_impulse_on_one_of_the_touching_bodies(seed: int) -> None:
    """Without gravity: the velocities at the end of the impulse, upwards or downwards."""
    masses, e, size, _, settings = draw(seed)
    n, rng = len(masses), np.random.default_rng(seed)
    hit, push = int(rng.integers(0, n)), float(rng.choice([-1.0, 1.0]))
    m = pile(masses, e, size, False, gravity=0.0)
    m.event("kick", at=0.1, then=mb.Impulse(m.bodies[1 + hit], push * masses[hit] * size**4))
    simulation = Simulation(m, settings)
    simulation.advance(0.1)
    expected = rates_after(masses, push * np.eye(n)[hit], e, False)
    np.testing.assert_allclose(outputs(simulation, "rate", n) / size, expected, rtol=0.0, atol=1e-9)
    assert [event.name for event in simulation.events] == ["kick"]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("push", [0.0, 1e-6])
@pytest.mark.parametrize("ratio", [1e-6, 0.5, 1e6])
def test_a_body_lands_on_one_in_flight(ratio: float, push: float, size: float) -> None:
    """Closed form: the lower body returns from the floor and meets the upper one, which does not rebound. Together they
    leave the floor with half of their speed, whether a force presses them together or not, and come to rest there.
    """
    m = mb.Mechanism(gravity=(0.0, -G * size, 0.0))
    lower = m.body("lower", m.ground, mb.Translational(axis="y", start=0.5 * size, nominal=size), mass=2.0 * size**3)
    joint = mb.Translational(axis="y", start=0.4 * size, nominal=size)
    upper = m.body("upper", lower, joint, mass=2.0 * ratio * size**3)
    m.force("press", mb.JointForce(-push * ratio * size**4), upper)
    m.event("floor", lower.coordinate(), direction="down", then=mb.Bounce(0.5))
    m.event("top", upper.coordinate(), direction="down", then=mb.Bounce(0.0))
    m.output("floor", lower.coordinate())
    m.output("top", upper.coordinate())
    result = mb.simulate(m, 2.0, interval=0.01, solver="ida", tolerance=TOLERANCE)
    u, first = np.sqrt(G), 1.0 / np.sqrt(G)
    meet = first + 0.4 / (1.5 * u)
    rise, fall = 0.5 * u - G * (meet - first), -u - G * (meet - first)
    v = (rise + ratio * fall) / (1.0 + ratio)
    height = 0.5 * u * (meet - first) - 0.5 * G * (meet - first) ** 2
    speed = np.sqrt(v * v + 2.0 * G * height)
    again = meet + (v + speed) / G
    flight = (result.t > again + 1e-3) & (result.t < again + speed / G - 1e-3)
    assert flight.sum() > 3
    t = result.t[flight] - again
    np.testing.assert_allclose(result["floor"][flight] / size, 0.5 * speed * t - 0.5 * G * t * t, atol=2e-6)
    np.testing.assert_allclose(result["top"][result.t > meet] / size, 0.0, rtol=0.0, atol=TOLERANCE)
    if ratio < 1e6:  # there rounding errors separate the bodies
        assert [event.name for event in result.events].count("top") == 1
    rests = result.t > again + 2.0 * speed / G + 0.01
    assert np.all(result["floor"][rests] == 0.0)
    assert np.all(result["top"][rests] == 0.0)
    assert not result.failed
    assert not result.warning


def test_bodies_with_a_gap_hit_each_other_one_after_the_other() -> None:
    """Closed form: of three equal bodies with restitution 1 only the last one moves after the first has hit the second
    one, if there is a gap between the second and the third. If they touch, both move with 2 / 3 of its velocity.
    """
    for gap, expected in ((1e-3, [0.0, 0.0, 1.0]), (0.0, [-1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0])):
        m = mb.Mechanism()
        for k, place in enumerate((0.0, 0.5, 0.5 + gap)):
            joint = mb.Translational(axis="x", start=place, rate=0.0 if k else 1.0)
            before, body = m.bodies[-1], m.body(f"body{k}", m.ground, joint, mass=1.0)
            m.output(f"rate{k}", body.rate())
            if k:
                distance = m.relative_position(body, before, "x")
                m.event(f"hit{k}", distance, direction="down", then=mb.Bounce(1.0))
        simulation = Simulation(m, Settings(solver="adams", tolerance=TOLERANCE))
        simulation.advance(1.0)
        np.testing.assert_allclose(outputs(simulation, "rate", 3), expected, rtol=0.0, atol=1e-9)
