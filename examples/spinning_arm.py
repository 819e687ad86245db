"""A flexible arm that is spun up: why geometric stiffening is an effect one may need (Kane, Ryan and Banerjee 1987).

    mbfmu run examples/spinning_arm.py:SpinningArm
    mbfmu run examples/spinning_arm.py:SpinningArm --set stiffening=false
    mbfmu effects examples/spinning_arm.py:SpinningArm

The arm is clamped to a hub that runs up to 6 rad/s within 15 s, faster than the arm's first natural frequency. The tip
lags behind by half a meter and comes back, because the centrifugal force straightens the arm. Linear modes alone do not
know that force: to them the arm softens as it spins faster, and runs away. Data are those of Simo and Vu-Quoc (1986).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from mbfmu.mechanics import MODES, Beam, Mechanism, Revolute, RunUp
from mbfmu.modeling import Model, parameter


@dataclass(frozen=True, kw_only=True)
class SpinningArm(Model):
    """Flexible arm on a hub that runs up to speed."""

    name = "spinning_arm"
    stop_time = 20.0
    output_interval = 0.02
    effects = MappingProxyType({"stiffening": {"stiffening": True}})

    length: float = parameter(10.0, unit="m", min=1e-3, doc="arm, from the axis to the tip")
    mass: float = parameter(12.0, unit="kg", min=1e-6, doc="arm, uniform")
    bending_stiffness: float = parameter(1.4e4, unit="N.m2", min=1e-6, doc="E I")
    modes: int = parameter(
        2, min=1, max=MODES, structural=True, resolution=(2, 4, 8), doc="modes of bending, clamped at the axis"
    )
    elements: int = parameter(
        10, min=1, max=1000, resolution=(10, 20, 40), doc="finite elements the modes are computed with"
    )
    speed: float = parameter(6.0, unit="rad/s", doc="of the hub after the run-up")
    duration: float = parameter(15.0, unit="s", min=1e-3, doc="of the run-up")
    stiffening: bool = parameter(True, structural=True, doc="effect: the centrifugal force resists bending")

    def build(self) -> Mechanism:
        """Return the mechanism: the arm turns in the x-y plane about z and bends in it."""
        m = Mechanism()
        beam = Beam(
            length=self.length,
            mass=self.mass,
            bending_stiffness=self.bending_stiffness,
            modes=self.modes,
            elements=self.elements,
            ends=("clamped", "free"),
            stiffening=self.stiffening,
        )
        arm = m.flexible_body("arm", m.ground, Revolute(drive=RunUp(speed=self.speed, duration=self.duration)), beam)
        m.output("tip.deflection", arm.deflection(self.length), "tip across the turning axis of the arm")
        m.output("root.moment", arm.moment(0.0), "bending moment at the hub")
        m.output("hub.angle", arm.body.angle(), "angle of the hub")
        m.output("hub.speed", arm.body.rate(), "its speed")
        m.output("hub.torque", arm.body.effort(), "torque that drives it")
        m.output("energy", m.energy, "kinetic and strain energy")
        return m
