"""A sheet on a carriage that a controller moves."""

from __future__ import annotations

from typing import Any

import mbfmu as mb

FILTER_TIME, TARGET, PROPORTIONAL, INTEGRAL = 0.01, 0.02, 8.0, 60.0  # s, m, N/m, N/(m s)


def carried_sheet(force: Any = None) -> mb.Mechanism:
    """A clamped sheet on a carriage with a spring; a force on the carriage as given, or by a controller that positions
    the free corner by a filtered sensor.
    """
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    carriage = m.body("carriage", m.ground, mb.Translational(axis="y"), mass=0.05)
    m.force("spring", mb.JointSpring(stiffness=40.0, damping=0.4), carriage)
    support = mb.Support("x0", body=carriage, at=(0.0, 0.0, 0.0))
    sheet = mb.add_sheet(
        m, "sheet", length=0.2, width=0.1, thickness=5e-4, youngs_modulus=3e9, density=1200.0, grid=(7, 4),
        supports=[support], damping=2e-3,
    )  # fmt: skip
    corner = sheet.node(-1, -1)
    m.output("corner", corner.position("y"))
    if force is None:
        seen = m.lag("seen", corner.position("y"), time_constant=FILTER_TIME, nominal=0.01)
        control = m.pid("control", TARGET, seen, proportional=PROPORTIONAL, integral=INTEGRAL, nominal=0.1)
        m.output("seen", seen.value())
        m.output("force", control.value())
        m.force("drive", mb.JointForce(control), carriage)
    else:
        m.force("drive", mb.JointForce(force), carriage)
    return m
