"""Models that lack free coordinates, constraints, inputs, outputs or parameters; a file for the command line."""

from __future__ import annotations

from dataclasses import dataclass

import mbfmu as mb


@dataclass(frozen=True, kw_only=True)
class DrivenArm(mb.Model):
    """An arm whose only joint is driven by an input."""

    mass: float = mb.parameter(1.0, unit="kg", min=0.1, max=10.0, doc="mass of the arm")

    def build(self) -> mb.Mechanism:
        """Return the arm."""
        m = mb.Mechanism(gravity=(0, -9.81, 0))
        drive = mb.Input(name="target", unit="rad", start=0.3)
        arm = m.body("arm", m.ground, mb.Revolute(drive=drive), **mb.rod(mass=self.mass, length=1))
        m.output("torque", arm.effort())
        return m


@dataclass(frozen=True, kw_only=True)
class DrivenLoop(mb.Model):
    """A parallelogram with all joints driven: equations of its cut joint are zero, and nothing is settable."""

    def build(self) -> mb.Mechanism:
        """Return the loop."""
        m = mb.Mechanism(gravity=(0, -9.81, 0))
        there, back = (mb.Harmonic(amplitude=a, frequency=0.2) for a in (0.3, -0.3))
        crank = m.body("crank", m.ground, mb.Revolute(drive=there), **mb.rod(mass=1, length=1))
        coupler = m.body("coupler", crank, mb.Revolute(at=(1, 0, 0), drive=back), **mb.rod(mass=3, length=3))
        rocker = m.body("rocker", coupler, mb.Revolute(at=(3, 0, 0), drive=there), **mb.rod(mass=1, length=-1))
        m.cut("pivot", mb.RevoluteCutJoint(at_a=(-1, 0, 0), at_b=(3, 0, 0)), rocker, m.ground)
        m.output("angle", rocker.angle())
        return m


@dataclass(frozen=True, kw_only=True)
class Welded(mb.Model):
    """A body that is welded to the ground: nothing moves, nothing is set, nothing is read."""

    def build(self) -> mb.Mechanism:
        """Return the body."""
        m = mb.Mechanism(gravity=(0, -9.81, 0))
        m.body("arm", m.ground, mb.Weld(), **mb.rod(mass=1, length=1))
        return m


@dataclass(frozen=True, kw_only=True)
class Silent(mb.Model):
    """A pendulum without inputs, outputs and parameters."""

    def build(self) -> mb.Mechanism:
        """Return the pendulum."""
        m = mb.Mechanism(gravity=(0, -9.81, 0))
        m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1, length=1))
        return m


@dataclass(frozen=True, kw_only=True)
class Truss(mb.Model):
    """A triangle of bars: coordinates, as many constraints, and no degree of freedom."""

    def build(self) -> mb.Mechanism:
        """Return the triangle."""
        m = mb.Mechanism(gravity=(0, -9.81, 0))
        a = m.body("a", m.ground, mb.Revolute(start=1.0), **mb.rod(mass=1, length=1))
        b = m.body("b", a, mb.Revolute(at=(1, 0, 0), start=-2.0), **mb.rod(mass=1, length=1))
        m.cut("pin", mb.RevoluteCutJoint(at_a=(1, 0, 0), at_b=(1, 0, 0)), b, m.ground)
        m.output("angle", a.angle())
        return m
