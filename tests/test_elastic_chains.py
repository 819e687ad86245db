"""Chains of elastic beams against Lagrange's equations in absolute angles, integrated by SciPy."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.session.simulation import Settings, Simulation
from solvers.steppers.adams.dense import AdamsStepper
from solvers.steppers.adams.eliminated import EliminatedAdamsStepper
from solvers.steppers.adams.tree import TreeAdamsStepper

G, ELEMENTS, SIZES = 9.81, 6, (1e-3, 1.0, 1e3)


@cache
def beam(modes: int, size: float, beams: int) -> mb.Beam:
    """A beam with pinned ends; the first natural frequency is that of a pendulum of a few of its lengths."""
    length, mass = size / beams, 1.0 / beams
    stiffness = 2.0 * G * mass * length**2
    return mb.Beam(length=length, mass=mass, bending_stiffness=stiffness, modes=modes, elements=ELEMENTS)


def beams_of(coordinates: int, size: float) -> list[mb.Beam]:
    """Beams with an angle and two modes each, the last with one to three modes."""
    count = (coordinates - 2) // 3 + 1
    return [beam(2, size, count)] * (count - 1) + [beam(coordinates - 3 * (count - 1) - 1, size, count)]


def chain(coordinates: int, size: float = 1.0, *, loop: bool = False) -> mb.Mechanism:
    """Beams in a row, connected by hinges, ``size`` m and 1 kg together; ``loop``: the last end is on the ground."""
    m, place, before = mb.Mechanism(gravity=(0.0, -G, 0.0)), None, None
    for i, own in enumerate(beams_of(coordinates, size)):
        joint = mb.Revolute(start=0.0 if i else -0.4)
        handle = m.flexible_body(f"beam{i}", place or m.ground, joint, own)
        place, before = handle.section(own.length), handle
    assert before is not None
    if loop:
        reach = 0.9 * size * np.array([np.cos(0.4), -np.sin(0.4), 0.0])
        m.cut("end", mb.PlaneCutJoint(at_a=reach, axis="x"), m.ground, place)
    return m


class Integrals:
    """Integrals over one beam, by Gauss's rule in every element, which is exact for its cubic shapes."""

    def __init__(self, own: mb.Beam) -> None:
        points, weights = np.polynomial.legendre.leggauss(4)
        h = own.length / ELEMENTS
        x = (h * (np.arange(ELEMENTS)[:, None] + 0.5 * (1.0 + points))).ravel()
        self.dm = np.tile(0.5 * weights * own.mass / ELEMENTS, ELEMENTS)
        self.x, self.phi = x, np.array([own.shape(at)[0] for at in x])
        self.end_slope = own.shape(own.length)[1]
        self.mass = self.phi.T @ (self.dm[:, None] * self.phi)
        self.stiffness = np.diag(np.diag(self.mass) * own.frequencies**2)


class Chain:
    """Accelerations of angles from the horizontal and of amplitudes, from M u' = f by the motion of all points."""

    def __init__(self, beams: list[mb.Beam]) -> None:
        self.beams = beams
        known = {id(own): Integrals(own) for own in beams}
        self.integrals = [known[id(own)] for own in beams]
        self.modes = [len(own.frequencies) for own in beams]
        self.first = np.cumsum([0, *(1 + modes for modes in self.modes)])
        self.n = int(self.first[-1])

    def transformation(self) -> Any:
        """Matrix that gives angles and amplitudes from the joint angles and the amplitudes."""
        T = np.eye(self.n)
        for i in range(1, len(self.beams)):
            before = self.first[i - 1]
            T[self.first[i]] += T[before]
            T[self.first[i], before + 1 : self.first[i]] += self.integrals[i - 1].end_slope
        return T

    def accelerations(self, u: Any, rate: Any) -> Any:
        """Return u'' (n,) at angles and amplitudes u and their rates."""
        return np.linalg.solve(*self.equations(u, rate))

    def held_accelerations(self, u: Any) -> Any:
        """Return u'' (n,) at rest if the last end cannot move along x."""
        (M, f), n, angles = self.equations(u, 0.0 * u), self.n, self.first[:-1]
        J = np.zeros((1, n))
        J[0, angles] = -self.beams[0].length * np.sin(u[angles])
        J /= self.beams[0].length
        return np.linalg.solve(np.block([[M, J.T], [J, np.zeros((1, 1))]]), np.r_[f, 0.0])[:n]

    def equations(self, u: Any, rate: Any) -> tuple[Any, Any]:
        """Return M (n, n) and f (n,)."""
        n, angles = self.n, self.first[:-1]
        e, normal = np.array([np.cos(u[angles]), np.sin(u[angles])]), np.array([-np.sin(u[angles]), np.cos(u[angles])])
        M, f, gravity = np.zeros((n, n)), np.zeros(n), np.array([0.0, -G])
        A, start = np.zeros((2, n)), np.zeros(2)  # motion of the first point of a beam, and its acceleration at u'' = 0
        for i, (own, integrals) in enumerate(zip(self.beams, self.integrals, strict=True)):
            at, end = self.first[i], self.first[i + 1]
            p, dp, turn = u[at + 1 : end], rate[at + 1 : end], rate[at]
            w, dw, dm = integrals.phi @ p, integrals.phi @ dp, integrals.dm
            B = np.zeros((len(dm), 2, end - at))
            B[:, :, 0] = np.outer(integrals.x, normal[:, i]) - np.outer(w, e[:, i])
            B[:, :, 1:] = normal[:, i, None] * integrals.phi[:, None, :]
            bias = -np.outer(integrals.x, e[:, i]) * turn**2 - np.outer(w, normal[:, i]) * turn**2
            bias += -2.0 * np.outer(dw, e[:, i]) * turn + start
            sum_B, sum_bias = np.einsum("p,pij->ij", dm, B), dm @ (gravity - bias)
            M[:at, :at] += dm.sum() * A[:, :at].T @ A[:, :at]
            M[:at, at:end] += A[:, :at].T @ sum_B
            M[at:end, at:end] += np.einsum("p,pij,pik->jk", dm, B, B)
            f[:at] += A[:, :at].T @ sum_bias
            f[at:end] += np.einsum("p,pij,pi->j", dm, B, gravity - bias)
            f[at + 1 : end] -= integrals.stiffness @ p
            A[:, at] = own.length * normal[:, i]
            start = start - own.length * e[:, i] * turn**2
        return np.triu(M) + np.triu(M, 1).T, f


def random_state(reference: Chain, size: float) -> tuple[Any, Any]:
    """Joint angles and amplitudes, and their rates."""
    rng = np.random.default_rng(3)
    amplitude = np.ones(reference.n) * 0.02 * size / len(reference.beams)
    amplitude[reference.first[:-1]] = 0.1
    q, v = rng.normal(size=(2, reference.n)) * amplitude
    return q, v * np.sqrt(G / size)


@pytest.mark.parametrize(
    ("coordinates", "size", "kind"),
    [
        *((59, size, AdamsStepper) for size in SIZES),
        *((61, size, TreeAdamsStepper) for size in SIZES),
        (1200, 1.0, TreeAdamsStepper),
    ],
)
def test_accelerations_are_those_of_lagranges_equations(coordinates: int, size: float, kind: type) -> None:
    reference = Chain(beams_of(coordinates, size))
    simulation = Simulation(chain(coordinates, size), Settings(solver="adams"))
    stepper: Any = simulation.stepper
    assert isinstance(stepper, kind)
    assert reference.n == coordinates
    q, v = random_state(reference, size)
    stepper._q[:], stepper._v[:] = q, v
    T = reference.transformation()
    expected = np.linalg.solve(T, reference.accelerations(T @ q, T @ v)) / simulation.compiled.system.size
    found = stepper.accelerations()[0] / simulation.compiled.system.size
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_a_chain_moves_according_to_lagranges_equations() -> None:
    reference = Chain(beams_of(61, 1.0))
    T, n = reference.transformation(), reference.n
    u = T @ np.r_[-0.4, np.zeros(n - 1)]
    exact = solve_ivp(
        lambda t, y: np.r_[y[n:], reference.accelerations(y[:n], y[n:])], (0.0, 0.1), np.r_[u, np.zeros(n)],
        "DOP853", rtol=1e-9, atol=1e-10,
    ).y[:n, -1]  # fmt: skip
    simulation = Simulation(chain(61), Settings(solver="adams", tolerance=1e-9))
    assert simulation.advance(0.1).ok
    np.testing.assert_allclose(T @ simulation.stepper.q, exact, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("coordinates", "size"), [(61, 1e-3), (61, 1.0), (61, 1e3), (1200, 1.0)])
def test_a_held_end_is_eliminated(coordinates: int, size: float) -> None:
    reference = Chain(beams_of(coordinates, size))
    simulation = Simulation(chain(coordinates, size, loop=True), Settings(solver="adams"))
    stepper: Any = simulation.stepper
    assert isinstance(stepper, EliminatedAdamsStepper)
    T = reference.transformation()
    expected = np.linalg.solve(T, reference.held_accelerations(T @ stepper.q)) / simulation.compiled.system.size
    found = stepper.accelerations()[0] / simulation.compiled.system.size
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
