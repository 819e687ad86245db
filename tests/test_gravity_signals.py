"""Gravity that depends on time: chains of pendulums against absolute angles and SciPy, and identities."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism

from .test_events import SMALL

Array = NDArray[np.float64]
G, STRENGTH, FREQUENCY = 9.81, 0.5, 5.0  # m/s^2, relative, rad/s
LARGE = 61  # links: the first large model


def law(size: float) -> str:
    """Return gravity along y of a model of this size, so that all sizes move with the same angles."""
    return f"{-G * size!r} * (1 + {STRENGTH} * sin({FREQUENCY} * t))"


def chain(links: int, size: float = 1.0) -> mb.Mechanism:
    """Return slender rods of 1 kg, which are horizontal at the start."""
    m = mb.Mechanism(gravity=(0.0, law(size), 0.0))
    body = m.ground
    for k in range(links):
        at = (size / links if k else 0.0, 0.0, 0.0)
        joint = mb.Revolute(axis="z", at=at, start=0.0, fixed=True)
        body = m.body(f"link{k}", body, joint, **mb.rod(mass=1.0, length=size / links))
        m.output(f"angle{k}", body.angle())
    m.output("energy", m.energy)
    return m


@cache
def reference(links: int, duration: float) -> Array:
    """Return the joint angles (links,) of a chain of any size at the end, and the work of gravity of a chain of 1 m.

    Lagrange's equations of the angles a from the horizontal, i = 1 ... links, with the length l of a link,
    w_ij = links - max(i, j) + 1/2 and w_ii = links - i + 1/3:
    sum_j w_ij (cos(a_i - a_j) a_j'' + sin(a_i - a_j) a_j'^2) = (links - i + 1/2) g(t) / l cos(a_i).
    """
    length = 1.0 / links
    outer = links - np.arange(links) - 0.5
    shared = np.minimum.outer(outer, outer) - np.eye(links) / 6.0

    def rates(t: float, y: Array) -> Array:
        a, rate = y[:links], y[links:-1]
        g = -G * (1.0 + STRENGTH * np.sin(FREQUENCY * t))
        between = np.subtract.outer(a, a)
        right = outer * g / length * np.cos(a) - (shared * np.sin(between)) @ rate**2
        power = g * length * float(outer @ (np.cos(a) * rate))
        return np.concatenate((rate, np.linalg.solve(shared * np.cos(between), right), [power]))

    end = solve_ivp(rates, (0.0, duration), np.zeros(2 * links + 1), "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return np.append(np.diff(end[:links], prepend=0.0), end[-1])


@pytest.mark.parametrize("solver", SMALL)
def test_a_double_pendulum_moves_as_in_another_formulation(solver: str) -> None:
    result = mb.simulate(chain(2), 1.5, interval=1.5, solver=solver, tolerance=1e-8)
    np.testing.assert_allclose(result.values[-1, :2], reference(2, 1.5)[:2], atol=2e-5)
    assert result["energy"][-1] - result["energy"][0] == pytest.approx(reference(2, 1.5)[2], rel=2e-5)
    assert not result.warning


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_angles_do_not_depend_on_the_size(size: float) -> None:
    result = mb.simulate(chain(2, size), 1.5, interval=1.5, solver="adams", tolerance=1e-8)
    np.testing.assert_allclose(result.values[-1, :2], reference(2, 1.5)[:2], atol=2e-5)
    work = result["energy"][-1] - result["energy"][0]
    assert work / size**2 == pytest.approx(reference(2, 1.5)[2], rel=2e-5)  # of g and of the lengths
    assert not result.warning


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_large_chain_moves_as_in_another_formulation(solver: str) -> None:
    result = mb.simulate(chain(LARGE), 0.3, interval=0.3, solver=solver, tolerance=1e-7)
    np.testing.assert_allclose(result.values[-1, :LARGE], reference(LARGE, 0.3)[:LARGE], atol=1e-4)
    assert not result.warning


def test_a_constant_signal_loads_the_joints_as_a_number() -> None:
    """Bodies with centers of mass off their axes and a body without mass; all components of gravity."""

    def joint_forces(gravity: tuple[object, ...]) -> Array:
        m = mb.Mechanism(gravity=gravity)  # type: ignore[arg-type]
        rng = np.random.default_rng(5)
        body = m.body("base", m.ground, mb.Floating(), mass=2.0, com=(0.1, 0.2, -0.3), inertia=(0.3, 0.4, 0.5))
        for k, axis in enumerate("xyzx"):
            joint = mb.Revolute(axis=axis, at=rng.normal(size=3), start=float(rng.normal()))
            mass = 0.0 if k == 1 else 1.0 + k
            body = m.body(f"b{k}", body, joint, mass=mass, com=rng.normal(size=3), inertia=(1.0, 1.1, 1.2))
        compiled = CompiledMechanism(m)
        q, v = compiled.assemble()
        return compiled.inverse_dynamics(0.0, q, v, rng.normal(size=len(v)))

    number = (0.3, -9.81, 1.7)
    exact = joint_forces(number)
    signals: tuple[object, ...] = tuple(mb.Sum(0.25 * g, 0.75 * g) for g in number)
    np.testing.assert_allclose(joint_forces(signals), exact, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(joint_forces((number[0], signals[1], number[2])), exact, rtol=1e-12, atol=1e-12)


@dataclass(frozen=True, kw_only=True)
class Tilted(mb.Model):
    """A rod that hangs down, with gravity along x by a multiple of an input."""

    name = "tilted"

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(mb.Product(2.0, mb.Input(name="tilt", unit="m/s2")), -9.81, 0.0))
        m.body("bar", m.ground, mb.Revolute(start=-0.5 * np.pi), **mb.rod(mass=2.0, length=1.0))
        return m


def test_linear_model_by_an_input_in_a_signal() -> None:
    """A slender rod turns by 3/2 g / L, and gravity along x is two times the input."""
    np.testing.assert_allclose(mb.equilibrium(Tilted()).state_space.B, [[0.0], [3.0]], atol=1e-12)


def test_one_signal_is_kept_once() -> None:
    """It is evaluated for every body, and its points are not copied."""
    compiled = CompiledMechanism(chain(5))
    names = [type(own.signal).__name__ for own in compiled.signals(compiled.data)]
    assert names.count("Function") == 1


@pytest.mark.parametrize(
    "component", [mb.SpeedInput(name="g", unit="m/s2"), mb.Input(name="g", unit="m/s2", rate_name="dg")]
)
def test_inputs_with_a_rate_are_refused(component: object) -> None:
    with pytest.raises(mb.UserError, match="allowed: a number, an input without rate_name, or a signal"):
        mb.Mechanism(gravity=(0.0, component, 0.0))  # type: ignore[arg-type]


def test_flexible_bodies_are_refused() -> None:
    m = mb.Mechanism(gravity=(0.0, "-9.81 * t", 0.0))
    beam = mb.Beam(length=1.0, mass=1.0, bending_stiffness=10.0, modes=1)
    with pytest.raises(mb.UserError, match="gravity along y is a signal, and body 'beam' is flexible"):
        m.flexible_body("beam", m.ground, mb.Revolute(), beam)
