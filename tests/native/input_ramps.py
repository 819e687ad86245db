"""Models whose inputs are ramps, and their motions in closed form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import mbfmu as mb
from mbfmu.modeling import Model, parameter

MASS, STIFFNESS = 2.0, 200.0  # kg, N/m
FREQUENCY = np.sqrt(STIFFNESS / MASS)  # rad/s
KINDS = ("force", "spring", "speed", "position")


@dataclass(frozen=True)
class Ramps(Model):
    """A mass on a base that is at rest, or moved by an input."""

    kind: str = parameter("force", doc="What the input is", choices=KINDS, structural=True)

    default_solver = "adams"
    stop_time = 1.0

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        drive = {
            "speed": mb.SpeedInput(name="u", unit="m/s"),
            "position": mb.Input(name="u", unit="m"),
        }.get(self.kind)
        base = m.body("base", m.ground, mb.Translational(axis="x", drive=drive or 0.0), mass=1.0)
        bob = m.body("bob", base, mb.Translational(axis="x"), mass=MASS)
        if self.kind != "force":
            m.force("spring", mb.JointSpring(stiffness=STIFFNESS), bob)
        if drive is None:
            m.force("push", mb.JointForce(mb.Input(name="u", unit="N")), bob)
        m.output("x", bob.coordinate())
        m.output("v", bob.rate())
        m.output("base.x", base.coordinate())
        m.output("base.v", base.rate())
        return m


def exact(kind: str, t: Any, rate: float, start: float = 0.0) -> Mapping[str, Any]:
    """Return the outputs at t (s) after a start at rest, if the input is ``start + rate * t``.

    A base that is moved takes the bob with it at the start.
    """
    w = FREQUENCY
    if kind == "force":
        x, v = start * t**2 / 2 / MASS + rate * t**3 / 6 / MASS, start * t / MASS + rate * t**2 / 2 / MASS
        return {"x": x, "v": v, "base.x": 0.0 * t, "base.v": 0.0 * t}
    if kind == "spring":  # x'' + w^2 x = (start + rate t) / m
        x = (start * (1 - np.cos(w * t)) + rate * (t - np.sin(w * t) / w)) / STIFFNESS
        v = (start * w * np.sin(w * t) + rate * (1 - np.cos(w * t))) / STIFFNESS
        return {"x": x, "v": v, "base.x": 0.0 * t, "base.v": 0.0 * t}
    if kind == "speed":  # relative to the base: x'' + w^2 x = -rate
        x, v = -rate / w**2 * (1 - np.cos(w * t)), -rate / w * np.sin(w * t)
        return {"x": x, "v": v, "base.x": start * t + rate * t**2 / 2, "base.v": start + rate * t}
    # the base gets its rate by an impulse, the bob none
    x, v = -rate / w * np.sin(w * t), -rate * np.cos(w * t)
    return {"x": x, "v": v, "base.x": start + rate * t, "base.v": rate + 0.0 * t}
