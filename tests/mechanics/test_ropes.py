"""Ropes over pulleys: identities, closed forms of Atwood's machine and of tackles, and SciPy."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.fmi.export import export
from mbfmu.mechanics import Mechanism, Revolute, Translational
from mbfmu.testing import check_element
from mbfmu.util.errors import UserError
from mbfmu.viewer.drawing import draw

G = 9.81
STIFFNESS = 4000.0  # N/m
SIZES = (1e-3, 1.0, 1e3)  # m
TIGHT: dict[str, Any] = {"solver": "adams", "tolerance": 1e-10}
needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")


def test_a_rope_has_the_identities_of_loads() -> None:
    """Over five points of four bodies that move in space; a body occurs twice."""
    for length, damping in ((0.5, 0.0), (0.5, 0.02), (50.0, 0.1)):  # taut, taut and damped, slack
        random, m = np.random.default_rng(4), Mechanism(gravity=(0.3, -G, 0.5))
        bodies = [m.ground]
        for k, kind in enumerate((mb.Spherical, Revolute, mb.Floating, Translational)):
            solid: dict[str, Any] = {"mass": 1.0, "com": random.normal(size=3), "inertia": (1.0, 1.1, 1.2)}
            parent = bodies[int(random.integers(0, k + 1))]
            bodies.append(m.body(f"b{k}", parent, kind(at=random.normal(size=3)), **solid))
        path = [(bodies[k], random.normal(size=3)) for k in (2, 0, 4, 2, 3)]
        rope = m.rope("rope", path, length=length, stiffness=3.0, damping=damping)
        for name in ("tension", "length", "length_rate"):
            m.output(name, getattr(rope, name)())
        report = check_element(m)
        assert report.passed, report


@dataclass(frozen=True, kw_only=True)
class Atwood(mb.Model):
    """Two weights on a rope over a pulley, which start at the equilibrium of the elongation."""

    heavy: float = mb.parameter(3.0, unit="kg", min=0.0, doc="Mass of the heavy weight")
    light: float = mb.parameter(1.0, unit="kg", min=0.0, doc="Mass of the light weight")
    size: float = mb.parameter(1.0, unit="m", min=0.0, doc="Radius of the pulley")
    rope: float = mb.parameter(12.0 - 1.5 * G / STIFFNESS, min=0.0, doc="Length of the rope in radii of the pulley")

    @property
    def tension(self) -> float:
        """2 m M g / (m + M), N."""
        return 2.0 * self.heavy * self.light * self.gravity / (self.heavy + self.light)

    @property
    def gravity(self) -> float:
        """The motion takes the same time at every size."""
        return G * self.size

    def build(self) -> Mechanism:
        size = self.size
        m = Mechanism(gravity=(0.0, -self.gravity, 0.0))
        weights = [
            m.body(name, m.ground, Translational(at=(x * size, 0.0, 0.0), axis="y", start=-5.0 * size), mass=mass)
            for name, x, mass in (("heavy", -1.0, self.heavy), ("light", 1.0, self.light))
        ]
        path = [(weights[0], (0, 0, 0)), (m.ground, (-size, 0, 0)), (m.ground, (size, 0, 0)), (weights[1], (0, 0, 0))]
        rope = m.rope("rope", path, length=self.rope * size, stiffness=STIFFNESS)
        m.output("down", weights[0].coordinate())
        m.output("up", weights[1].coordinate())
        m.output("tension", rope.tension())
        m.output("length", rope.length())
        m.output("energy", m.energy)
        return m


@pytest.mark.parametrize("size", SIZES)
def test_atwoods_machine(size: float) -> None:
    """a = g (M - m) / (M + m); the rope starts with its tension 2 m M g / (m + M), and so does not vibrate."""
    model = Atwood(size=size)
    result = mb.simulate(model, 0.5, **TIGHT)
    assert not result.warning
    way = 0.25 * model.gravity * result.t**2
    np.testing.assert_allclose(result["down"], -5.0 * size - way, rtol=1e-8)
    np.testing.assert_allclose(result["up"], -5.0 * size + way, rtol=1e-8)
    np.testing.assert_allclose(result["tension"], model.tension, rtol=1e-4)
    np.testing.assert_allclose(result["length"], 12.0 * size, rtol=1e-8)
    np.testing.assert_allclose(result["energy"], result["energy"][0], rtol=1e-8)


def tackle(parts: int, load: float, counterweight: float) -> tuple[Mechanism, Any]:
    """A block on several parts of a rope, whose end carries a counterweight; it starts at the unloaded length."""
    m, spacing = Mechanism(gravity=(0.0, -G, 0.0)), 0.1
    block = m.body("block", m.ground, Translational(axis="y", start=-3.0), mass=load)
    weight = m.body("weight", m.ground, Translational(axis="y", at=(1.0, 0.0, 0.0), start=-2.0), mass=counterweight)
    x = [k * spacing for k in range(parts)]  # of the vertical parts
    path: list[Any] = []
    for k in range(parts):
        pair = [(block, (x[k], 0.0, 0.0)), (m.ground, (x[k], 0.0, 0.0))]
        path += pair if k % 2 == parts % 2 ^ 1 else pair[::-1]
    path += [(m.ground, (1.0, 0.0, 0.0)), (weight, (0.0, 0.0, 0.0))]
    between = spacing * (parts - 1) + 1.0 - x[-1]
    rope = m.rope("rope", path, length=3.0 * parts + between + 2.0, stiffness=2e4)
    m.output("tension", rope.tension())
    return m, rope


@pytest.mark.parametrize("parts", [2, 3, 4, 5])
def test_a_tackle_multiplies_the_force(parts: int) -> None:
    """Balance and motion of a load that ``parts`` segments of the rope carry."""
    weight = 2.0
    m, _ = tackle(parts, parts * weight, weight)
    rest = mb.equilibrium(m)
    elongation = weight * G / 2e4
    q = np.asarray(rest.q)
    np.testing.assert_allclose(parts * (q[0] + 3.0) + (q[1] + 2.0), -elongation, rtol=1e-6)
    result = mb.simulate(m, 0.1, **TIGHT)
    # elongation x = -(n q0 + q1): x'' = g (n + 1) - k x (n / weight + 1 / weight), n^2 / M + 1 / m with M = n m
    rate = np.sqrt(2e4 * (parts + 1.0) / weight)
    found = np.abs(np.linalg.eigvals(mb.linearize(m).A))  # and one motion at which the rope keeps its length
    np.testing.assert_allclose(np.sort(found)[-2:], rate, rtol=1e-6)
    np.testing.assert_allclose(
        result["tension"], weight * G * (1.0 - np.cos(rate * result.t)), rtol=1e-6, atol=1e-6 * weight * G
    )


@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_a_pendulum_that_is_hoisted_moves_as_scipy_integrates_it(damping: float) -> None:
    """A bob in the plane on a rope over a point, with a counterweight; slack at first."""
    k, length, bob, weight = 500.0, 3.05, 1.0, 1.5
    m = Mechanism(gravity=(0.0, -G, 0.0))
    across = m.body("across", m.ground, Translational(axis="x", start=0.6), mass=0.0)
    swinging = m.body("bob", across, Translational(axis="y", start=-0.8), mass=bob)
    lift = m.body("lift", m.ground, Translational(axis="y", at=(-1.0, 0.0, 0.0), start=-1.0), mass=weight)
    path = [(swinging, (0, 0, 0)), (m.ground, (0, 0, 0)), (m.ground, (-1.0, 0, 0)), (lift, (0, 0, 0))]
    m.rope("rope", path, length=length, stiffness=k, damping=damping)
    m.output("x", across.coordinate())
    m.output("y", swinging.coordinate())
    m.output("lift", lift.coordinate())
    result = mb.simulate(m, 1.0, **TIGHT, max_step=5e-3)
    assert not result.warning

    def law(_: float, s: Any) -> Any:
        x, y, z, u, v, w = s
        r = np.hypot(x, y)
        stretch, rate = r + 1.0 - z - length, (x * u + y * v) / r - w
        T = k * stretch * max(1.0 + damping * rate, 0.0) if stretch > 0.0 else 0.0
        return [u, v, w, -T * x / r / bob, -T * y / r / bob - G, T / weight - G]

    def taut(_: float, s: Any) -> float:
        return float(np.hypot(s[0], s[1]) + 1.0 - s[2] - length)

    start = [0.6, -0.8, -1.0, 0.0, 0.0, 0.0]
    exact = solve_ivp(law, (0.0, 1.0), start, "DOP853", result.t, rtol=1e-11, atol=1e-12, max_step=1e-3, events=taut)
    assert len(exact.t_events[0]) >= 1
    for row, name in enumerate(("x", "y", "lift")):
        np.testing.assert_allclose(result[name], exact.y[row], atol=1e-6)


def test_a_large_model_is_carried_by_ropes() -> None:
    """Atwood's machines whose weights are 62 coordinates: the structured tangent of loads on several bodies."""
    m, count = Mechanism(gravity=(0.0, -G, 0.0)), 31
    for i in range(count):
        ends = [
            m.body(f"{name}{i}", m.ground, Translational(axis="y", at=(x, 0, i), start=-5.0), mass=mass)
            for name, x, mass in (("heavy", -1.0, 3.0), ("light", 1.0, 1.0))
        ]
        over = [(m.ground, (-1.0, 0.0, i)), (m.ground, (1.0, 0.0, i))]
        m.rope(
            f"rope{i}", [(ends[0], (0, 0, 0)), *over, (ends[1], (0, 0, 0))], length=12.0 - 1.5 * G / 4e3, stiffness=4e3
        )
        m.output(f"way{i}", ends[0].coordinate())
    result = mb.simulate(m, 0.2, solver="ida", tolerance=1e-7)
    assert not result.warning
    for i in range(count):
        np.testing.assert_allclose(result[f"way{i}"], -5.0 - 0.25 * G * result.t**2, atol=1e-5)


@needs_compiler
def test_a_native_fmu_of_a_rope_follows_its_parameters(tmp_path: Path) -> None:
    settings = mb.Settings(solver="radau", tolerance=1e-8)
    path = export(Atwood(), tmp_path / "atwood.fmu", settings, native=True)
    values = {"heavy": 2.0, "size": 0.5, "rope": 12.0 - 4.0 / 3.0 * G / STIFFNESS}
    other = Atwood(**values)
    found = simulate_fmu(str(path), stop_time=0.5, output_interval=0.1, start_values=values, fmi_type="CoSimulation")
    np.testing.assert_allclose(found["down"], -2.5 - other.gravity / 6.0 * found["time"] ** 2, rtol=1e-5)
    np.testing.assert_allclose(found["tension"], other.tension, rtol=1e-3)


def test_animations_show_every_segment() -> None:
    found = draw(Atwood().build(), 10.0).links
    assert [(link.a, link.b) for link in found[-3:]] == [(1, 0), (0, 0), (0, 2)]


def test_points_that_coincide_are_reported() -> None:
    m = Mechanism(gravity=(0.0, -G, 0.0))
    bob = m.body("bob", m.ground, Translational(axis="y"), mass=1.0)
    m.rope("rope", [(m.ground, (0, 0, 0)), (bob, (0, 0, 0)), (m.ground, (1, 0, 0))], length=1.0, stiffness=1.0)
    found = [text for text in map(str, mb.simulate(m, 0.01, solver="adams").diagnostics) if "coincide" in text]
    assert len(found) == 1
    assert "two neighboring points of load 'rope' coincide at the start" in found[0]


@pytest.mark.parametrize(
    ("path", "values", "message"),
    [
        ([(0, (0, 0, 0))], {}, "path of rope 'r' has 1 points, 1 of them pairs; allowed: two or more pairs"),
        ([(0, (0, 0, 0)), (0, (1, 0, 0))], {}, "path of rope 'r' has points of body 'ground' alone"),
        ([(0, (0, 0, 0)), (1, (1, 0))], {}, "a point of rope 'r' is"),
        ([(0, (0, 0, 0)), (1, (1, 0, 0))], {"length": 0.0}, "length of load 'r' is 0.0"),
        ([(0, (0, 0, 0)), (1, (1, 0, 0))], {"stiffness": -1.0}, "stiffness of load 'r' is -1.0"),
        ([(0, (0, 0, 0)), (1, (1, 0, 0))], {"damping": -1.0}, "damping of load 'r' is -1.0"),
    ],
)
def test_what_is_no_rope_is_refused(path: Any, values: dict[str, float], message: str) -> None:
    m = Mechanism()
    m.body("b", m.ground, Translational(axis="x"), mass=1.0)
    with pytest.raises(UserError, match=message):
        m.rope("r", [(m.bodies[k], point) for k, point in path], **{"length": 1.0, "stiffness": 1.0} | values)
