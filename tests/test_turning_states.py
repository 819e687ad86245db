"""Steady states of closed loops that turn, for every cut joint, against the effective potential of one angle."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from fmus.governor import Governor
from mbfmu.mechanics import (
    DistanceCutJoint,
    JointSpring,
    Mechanism,
    PlanarCutJoint,
    PlaneCutJoint,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    Spherical,
    SphericalCutJoint,
    Translational,
    WeldCutJoint,
    rod,
)
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings
from mbfmu.steady.equilibrium import build_problem, equilibrium
from mbfmu.util.errors import EquilibriumError

UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # z of the cut frame along y of the body
ARM, LINK, PIN = 1.0, 0.7, 0.6  # m: the arm, the link that carries it, and where on the arm
KINDS = ("distance", "spherical", "revolute", "weld", "plane", "planar")


@dataclass(frozen=True, kw_only=True)
class Umbrella(Model):
    """An arm on a column that turns, carried by a collar that slides up the column on a spring."""

    name = "umbrella"
    kind: str = "revolute"
    swapped: bool = False
    speed: float = 4.0
    mass: float = 2.0
    collar: float = 1.5
    stiffness: float = 400.0
    damping: float = 40.0
    link: float = 0.0

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        column = m.body("column", m.ground, Revolute(axis="y", drive=Polynomial((0.4, self.speed))), mass=3.0)
        arm = m.body("arm", column, Revolute(start=-0.2), **rod(mass=self.mass, length=ARM))
        collar = m.body("collar", column, Translational(axis="y", start=self.height(-0.2)), mass=self.collar)
        spring = JointSpring(stiffness=self.stiffness, damping=self.damping, free=self.height(0.0))
        m.force("spring", spring, collar)
        tie = {"at_a": (0.0, 0.0, 0.0), "at_b": (PIN, 0.0, 0.0)}
        on_collar, on_arm = collar, arm
        if self.kind in ("spherical", "revolute", "weld"):
            on_collar = m.body("link", collar, Revolute(start=1.0), **rod(mass=self.link, length=LINK))
            tie["at_a"] = (LINK, 0.0, 0.0)
        if self.kind in ("weld", "planar"):
            on_arm = m.body("shoe", arm, Revolute(at=(PIN, 0.0, 0.0), start=1.2 if self.kind == "weld" else 0.2))
            tie["at_b"] = (0.0, 0.0, 0.0)
        kinds: dict[str, Any] = {
            "distance": lambda **at: DistanceCutJoint(length=LINK, **at),
            "spherical": SphericalCutJoint,
            "revolute": RevoluteCutJoint,
            "weld": WeldCutJoint,
            "plane": lambda **at: PlaneCutJoint(rotation_a=UP, rotation_b=UP, **at),
            "planar": lambda **at: PlanarCutJoint(rotation_a=UP, rotation_b=UP, **at),
        }
        pair = [on_collar, on_arm]
        if self.swapped:
            pair, tie = pair[::-1], {"at_a": tie["at_b"], "at_b": tie["at_a"]}
        m.cut("tie", kinds[self.kind](**tie), *pair)
        m.output("arm.angle", arm.angle())
        m.output("collar.height", collar.coordinate())
        m.output("gap", m.position_residual)
        return m

    def height(self, angle: float) -> float:
        """Of the collar for an angle of the arm."""
        if self.kind in ("plane", "planar"):
            return PIN * sin(angle)
        return PIN * sin(angle) - sqrt(LINK**2 - (PIN * cos(angle)) ** 2)

    def torque(self, angle: float) -> float:
        """Generalized force along the arm's angle where everything is at rest but the column."""
        h = 1e-30
        swing = -self.mass * 9.81 * 0.5 * ARM * cos(angle)
        swing -= self.speed**2 * self.mass * ARM**2 / 3.0 * sin(angle) * cos(angle)
        lift = -self.collar * 9.81 - self.stiffness * (self.height(angle) - self.height(0.0))
        return swing + lift * complex_height(self, angle + 1j * h).imag / h

    def lever(self, angle: float) -> float:
        """Change of the collar's height with the angle."""
        return float(complex_height(self, angle + 1e-30j).imag / 1e-30)


def complex_height(model: Umbrella, angle: Any) -> Any:
    """:meth:`Umbrella.height` of a complex angle."""
    up = PIN * np.sin(angle)
    return up if model.kind in ("plane", "planar") else up - np.sqrt(LINK**2 - (PIN * np.cos(angle)) ** 2 + 0j)


def expected(model: Umbrella) -> tuple[float, Any]:
    """Angle of the steady state next to the start, and the eigenvalues of the motion about it."""
    angle = brentq(model.torque, -0.9, 0.5, xtol=1e-15)
    h = 1e-5
    stiffness = -(model.torque(angle + h) - model.torque(angle - h)) / (2.0 * h)
    inertia = model.mass * ARM**2 / 3.0 + model.collar * model.lever(angle) ** 2
    damping = model.damping * model.lever(angle) ** 2
    return angle, np.sort_complex(np.roots([inertia, damping, stiffness]))


@pytest.mark.parametrize(
    ("kind", "swapped"),
    [(kind, swapped) for kind in KINDS for swapped in (False, True) if not (swapped and kind == "plane")],
)  # a plane that the arm carries is another mechanism
def test_every_cut_joint_turns_with_its_column(kind: str, swapped: bool) -> None:
    """The steady state, its modes and its state matrices; links without mass, so that one angle is enough."""
    model = Umbrella(kind=kind, swapped=swapped)
    found = equilibrium(model)
    angle, values = expected(model)
    assert found.outputs["arm.angle"] == pytest.approx(angle, abs=1e-10)
    assert found.outputs["collar.height"] == pytest.approx(model.height(angle), abs=1e-10)
    assert found.stability == "stable"
    eigenvalues = np.linalg.eigvals(found.state_space.A)
    np.testing.assert_allclose(np.sort_complex(eigenvalues), values, rtol=1e-7)
    pair = [mode.eigenvalue for mode in found.modes]
    np.testing.assert_allclose(pair[0], values[np.argmax(values.imag)], rtol=1e-7)


@pytest.mark.parametrize(("kind", "solver"), [("spherical", "ida"), ("revolute", "adams"), ("plane", "adams")])
def test_damped_runs_settle_there(kind: str, solver: str) -> None:
    model = Umbrella(kind=kind, link=0.3, damping=200.0)
    found = equilibrium(model)
    result = run(model, Settings(solver=solver, tolerance=1e-8), np.linspace(0.0, 12.0, 13))  # 7.6 turns
    assert not result.failure
    assert result["arm.angle"][-1] == pytest.approx(found.outputs["arm.angle"], abs=1e-6)
    assert result["gap"].max() < 1e-6


@dataclass(frozen=True, kw_only=True)
class Rotor(Model):
    """An unbalanced disk on a shaft that turns, held by a bearing on the ground; gravity across the shaft or along."""

    name = "rotor"
    across: float = 0.0
    bearing_first: bool = True

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -self.across, -9.81))
        shaft = m.body("shaft", m.ground, Revolute(axis="z", drive=Polynomial((0.0, 20.0))), mass=1.0)
        x = m.body("x", shaft, Translational(axis="x"))
        disk = m.body("disk", x, Translational(axis="y"), mass=2.0, com=(0.01, 0.0, 0.0), inertia=(0.1, 0.1, 0.2))
        flap = m.body("flap", disk, Revolute(at=(0.1, 0, 0), axis="y", start=0.3), **rod(mass=0.2, length=0.2))
        m.force("spring", JointSpring(stiffness=1.0), flap)
        pair = (m.ground, disk) if self.bearing_first else (disk, m.ground)
        m.cut("bearing", SphericalCutJoint(), *pair)
        m.output("flap", flap.angle())
        return m


@pytest.mark.parametrize("bearing_first", [True, False])
def test_the_force_of_a_bearing_may_turn_with_the_shaft(bearing_first: bool) -> None:
    """The flap stands where its spring, its weight and the centrifugal force balance; the bearing carries the rest."""
    found = equilibrium(Rotor(bearing_first=bearing_first))

    def torque(angle: float) -> float:  # positive turns the tip down
        out = 20.0**2 * 0.2 * (0.1 * 0.1 * sin(angle) + 0.2**2 / 3.0 * sin(angle) * cos(angle))
        return 0.2 * 9.81 * 0.1 * cos(angle) - angle - out

    assert found.outputs["flap"] == pytest.approx(brentq(torque, 0.0, 1.0, xtol=1e-14), abs=1e-10)


@pytest.mark.parametrize("bearing_first", [True, False])
def test_weight_across_a_shaft_does_not_turn_with_it(bearing_first: bool) -> None:
    with pytest.raises(EquilibriumError, match="has no steady state: forces that balance at one position"):
        equilibrium(Rotor(across=9.81, bearing_first=bearing_first))


@dataclass(frozen=True, kw_only=True)
class Spun(Model):
    """A top: a heavy body on a ball joint, spinning."""

    name = "spun"

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, 0.0, -9.81))
        m.body(
            "top", m.ground, Spherical(rate=(0.0, 0.0, 30.0)), mass=1.0, com=(0, 0, 0.1), inertia=(0.01, 0.01, 0.004)
        )
        return m


def test_a_rate_that_is_changed_is_reported() -> None:
    note, family = (found.text for found in equilibrium(Spun()).diagnostics)
    assert family == "neutral family: 1 direction in which nothing changes"  # it may turn about its axis
    assert "the given rate of 'top.wz' (30) is not kept" in note
    assert equilibrium(Governor(driven=False)).diagnostics == ()  # its spindle spins on


def test_whole_turns_signs_and_cyclic_angles_are_no_new_states() -> None:
    problem = build_problem(Governor(driven=False, damping=20.0))
    a = problem.solve().q
    b = a + np.array([1.234, 2.0 * pi, -4.0 * pi, 0.0])  # the spindle's angle means nothing
    assert problem.same(a, b)
    assert not problem.same(a, a + np.array([0.0, 0.1, 0.0, 0.0]))
    problem = build_problem(Spun())
    e = problem.solve().q
    assert problem.same(e, -e)
