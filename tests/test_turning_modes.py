"""Modes and stability on turning bases, of small and of large mechanisms, against equations derived by hand."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import eig, eigh

import mbfmu as mb
from mbfmu.steady import modes as steady_modes

GRAVITY = 9.81


def rods(count: int, speed: float, size: float = 1.0) -> mb.Mechanism:
    """Rods on a spindle, each on a hinge that turns with it."""
    m = mb.Mechanism(gravity=(0.0, -GRAVITY, 0.0))
    spindle = mb.Revolute(axis="y", drive=mb.Polynomial((0.3, speed)))
    hub = m.body("hub", m.ground, spindle, mass=1.0, inertia=(1.0, 1.0, 1.0))
    for k in range(count):
        m.body(f"rod{k}", hub, mb.Revolute(start=-pi / 2.0), **mb.rod(mass=1.0, length=size))
    return m


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e3])
@pytest.mark.parametrize("count", [1, 59, 61, 70])
def test_rods_on_a_spindle(count: int, size: float) -> None:
    """(L^2 / 3) s^2 = (L^2 / 3) W^2 - g L / 2: the rod leaves the axis above W = sqrt(3 g / (2 L))."""
    own = 1.5 * GRAVITY / size
    for part, verdict in ((0.0, "undamped"), (0.6, "undamped"), (1.4, "unstable")):
        state = mb.equilibrium(rods(count, part * sqrt(own), size))
        assert state.stability == verdict
        expected = np.sqrt(complex((part**2 - 1.0) * own))
        for mode in state.shapes(2):
            assert np.sqrt(mode.mode.eigenvalue**2) == pytest.approx(expected, rel=1e-9)


def chain_matrices(count: int, speed: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """M and K of a chain of rods suspended from a point of a turning axis, by absolute angles, mass and length one.

    Centers at x_k, masses 1: kinetic and centrifugal energies are quadratic forms of the sines of the angles.
    """
    link = 1.0 / count
    S = link * (np.tril(np.ones((count, count)), -1) + 0.5 * np.eye(count))  # center by the angles
    own = link**2 / 12.0 * np.eye(count)
    M = (S.T @ S + own) / count
    hanging = GRAVITY / count * np.diag(S.sum(axis=0))
    return M, hanging - speed**2 * M


def chain(count: int, speed: float) -> mb.Mechanism:
    """The same as a mechanism."""
    m = mb.Mechanism(gravity=(0.0, -GRAVITY, 0.0))
    base = mb.Revolute(axis="y", drive=mb.Polynomial((0.0, speed)))
    body = m.body("base", m.ground, base, mass=1.0, inertia=(1.0, 1.0, 1.0))
    for k in range(count):
        at = (1.0 / count, 0.0, 0.0) if k else (0.0, 0.0, 0.0)
        joint = mb.Revolute(at=at, start=0.0 if k else -pi / 2.0)
        body = m.body(f"link{k}", body, joint, **mb.rod(mass=1.0 / count, length=1.0 / count))
    return m


@pytest.mark.parametrize("count", [30, 59, 61, 110])
def test_chain_on_a_turning_base(count: int) -> None:
    M, K = chain_matrices(count, 2.0)
    expected = np.sqrt(eigh(K, M, eigvals_only=True)[:4])
    state = mb.equilibrium(chain(count, 2.0))
    assert state.stability == "undamped"
    assert [shape.mode.frequency for shape in state.shapes(4)] == pytest.approx(expected, rel=1e-8)


def carts(count: int, speed: float, damping: float) -> mb.Mechanism:
    """Carts on a turntable, each a point that springs hold in two directions of it: C has the Coriolis forces."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    table = m.body(
        "table", m.ground, mb.Revolute(axis="z", drive=mb.Polynomial((0.2, speed))), mass=1.0, inertia=(1.0, 1.0, 1.0)
    )
    for k in range(count):
        slide = m.body(f"x{k}", table, mb.Translational(axis="x"), mass=0.0)
        cart = m.body(f"y{k}", slide, mb.Translational(axis="y"), mass=1.0)
        m.force(f"kx{k}", mb.JointSpring(stiffness=9.3 + k, damping=damping), slide)
        m.force(f"ky{k}", mb.JointSpring(stiffness=25.0, damping=damping), cart)
    return m


def cart_eigenvalues(count: int, speed: float, damping: float) -> list[complex]:
    """x'' - 2 W y' + d x' + (k - W^2) x = 0 and so on: fast enough, undamped carts are stable again."""
    found: list[complex] = []
    for k in range(count):
        C = np.array([[damping, -2.0 * speed], [2.0 * speed, damping]])
        K = np.diag([9.3 + k - speed**2, 25.0 - speed**2])
        state = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, -C]])
        found += list(eig(state, right=False))
    return sorted((s for s in found if s.imag >= -1e-12), key=abs)


TURNTABLES = [(0.0, 2.0), (0.0, 6.0), (0.3, 2.0), (0.3, 4.0), (0.3, 6.0)]


@pytest.mark.parametrize(("damping", "speed"), TURNTABLES)
@pytest.mark.parametrize("count", [29, 31])
def test_carts_on_a_turntable(count: int, damping: float, speed: float) -> None:
    expected = cart_eigenvalues(count, speed, damping)
    grows = max(s.real for s in expected) > 1e-6
    state = mb.equilibrium(carts(count, speed, damping))
    assert state.stability == ("unstable" if grows else "stable" if damping else "undamped")
    found = np.sort_complex(np.round([mode.eigenvalue for mode in state.modes], 7))
    assert found == pytest.approx(np.sort_complex(np.round(expected, 7)), abs=1e-6)


@pytest.mark.parametrize(("damping", "speed"), TURNTABLES)
def test_carts_too_many_for_matrices(damping: float, speed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """By Arnoldi with an inner iteration, as for more coordinates than matrices are assembled for."""
    expected = cart_eigenvalues(40, speed, damping)
    monkeypatch.setattr(steady_modes, "MAX_ASSEMBLED_COORDINATES", 10)
    state = mb.equilibrium(carts(40, speed, damping))
    for mode in state.modes:
        assert min(abs(mode.eigenvalue - s) for s in expected) < 1e-7
    fastest_growth = max(s.real for s in expected)
    assert state.stability == ("unstable" if fastest_growth > 1e-6 else "stable" if damping else "undamped")


@pytest.mark.parametrize(("slow", "fast"), [(0.05, 505.0), (0.05, 5e4), (1e-4, 1e4)])
@pytest.mark.parametrize("count", [3, 59, 70])
def test_slow_modes_with_fast_ones(count: int, slow: float, fast: float) -> None:
    def build(k: float) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
        for i in range(count):
            wheel = m.body(f"wheel{i}", m.ground, mb.Revolute(axis="z"), mass=1.0, inertia=(1.0, 1.0, 2.0))
            m.force(f"spring{i}", mb.JointSpring(stiffness=2.0 * (fast**2 if i else k)), wheel)
        return m

    state = mb.equilibrium(build(slow**2))
    assert state.stability == "undamped"
    assert [mode.frequency for mode in state.modes[:2]] == pytest.approx([slow, fast], rel=1e-9)
    if count < 60:  # of a large tree Newton does not find it
        assert mb.equilibrium(build(0.0)).stability == "neutral"


@pytest.mark.parametrize(("height", "verdict"), [(0.9, "undamped"), (1.1, "unstable"), (1e4, "unstable")])
def test_a_compressed_strip_buckles(height: float, verdict: str) -> None:
    """Clamped at both ends and moved together by h: straight it buckles at 4 pi^2 D / L^2 = E t h / L.

    Far above that the fastest growth is thousands of times faster than the slowest motion.
    """
    length, thickness = 0.3, 5e-5
    critical = pi**2 * thickness**2 / (3.0 * length)
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    push = mb.Translational(axis="x", drive=mb.Polynomial((-height * critical,)))
    moved = m.body("moved", m.ground, push)
    mb.add_sheet(
        m, "strip", length=length, width=0.02, thickness=thickness, youngs_modulus=4e9, poisson=0.0, density=1000.0,
        grid=(31, 3), stretch=True, supports=[mb.Support("x0"), mb.Support("x1", body=moved)],
    )  # fmt: skip
    assert mb.equilibrium(m).stability == verdict


@pytest.mark.parametrize("cells", [15, 31, 64])
def test_a_strip_on_a_hub_that_turns_in_its_plane_of_bending(cells: int) -> None:
    """At the dimensionless speed 12 it flaps with 13.1702 (Wright, Smith, Thresher, Wang 1982); in its plane less."""
    length, width, thickness, E, density = 0.3, 0.02, 1e-3, 4e9, 1000.0
    unit = sqrt(E * thickness**2 / (12.0 * density * length**4))
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    hub = mb.Revolute(axis="z", drive=mb.Polynomial((0.0, 12.0 * unit)))
    body = m.body("hub", m.ground, hub, mass=1.0, inertia=(1.0, 1.0, 1.0))
    mb.add_sheet(
        m, "strip", length=length, width=width, thickness=thickness, youngs_modulus=E, poisson=0.0, density=density,
        grid=(cells + 1, 2), supports=[mb.Support("x0", body=body)],
    )  # fmt: skip
    state = mb.equilibrium(m)
    bending = min(mode.frequency for mode in state.modes) / unit
    assert state.stability == "undamped"
    assert bending == pytest.approx(sqrt(13.1702**2 - 144.0), rel=0.02 * (15.0 / cells) ** 2 + 2e-3)


@pytest.mark.parametrize("count", [3, 61])
def test_a_path_of_rods_that_lean_outward(count: int) -> None:
    """sin q = -3 g / (2 L W^2) and w^2 = W^2 cos 2q - 3 g / (2 L) sin q over gravity, where the base turns at W."""
    speed = 5.0
    m = mb.Mechanism(gravity=(0.0, mb.Input(name="gravity", unit="m/s2", start=-GRAVITY), 0.0))
    spindle = mb.Revolute(axis="y", drive=mb.Polynomial((0.3, speed)))
    hub = m.body("hub", m.ground, spindle, mass=1.0, inertia=(1.0, 1.0, 1.0))
    for k in range(count):
        rod = m.body(f"rod{k}", hub, mb.Revolute(start=-0.5), **mb.rod(mass=1.0, length=1.0))
    m.output("angle", rod.angle())
    state = mb.equilibrium(m)
    lean = np.arcsin(-1.5 * GRAVITY / speed**2)
    assert state.outputs["angle"] == pytest.approx(lean, rel=1e-9)
    expected = sqrt(speed**2 * np.cos(2.0 * lean) - 1.5 * GRAVITY * np.sin(lean))
    assert state.modes[0].frequency == pytest.approx(expected, rel=1e-9)
    path = mb.equilibrium_path(m, "gravity", (-GRAVITY, -5.0))
    for at in path.branches[0].states:
        assert at.outputs["angle"] == pytest.approx(np.arcsin(1.5 * at.value / speed**2), rel=1e-8)
        assert (at.unstable, at.stability) == (0, "undamped")
