"""A model with a body of finite elements."""

from __future__ import annotations

from dataclasses import dataclass

from fe_models import bracket

import mbfmu as mb
from mbfmu.modeling import Model, parameter

FRAME = bracket(young=7e9)
BODY = mb.FlexibleBody.from_fe(FRAME.M, FRAME.K, FRAME.nodes, {"foot": [0], "tip": [5]}, modes=2, damping=0.02)


@dataclass(frozen=True, kw_only=True)
class SwungBracket(Model):
    """Bracket on a hinge with a pendulum on its tip."""

    name = "swung_bracket"

    mass: float = parameter(0.1, unit="kg", min=0.01, doc="mass of the pendulum")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
        handle = m.flexible_body("bracket", m.ground, mb.Revolute(start=-1.0), BODY)
        bob = m.body("bob", handle.section("tip"), mb.Revolute(), **mb.rod(mass=self.mass, length=0.2))
        m.output("hinge", handle.body.angle())
        m.output("bob", bob.angle())
        for axis in "xyz":
            m.output(f"tip.{axis}", m.relative_position(handle.section("tip"), handle.body, axis))
        m.output("energy", m.energy)
        return m
