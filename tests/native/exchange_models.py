"""Models that native FMUs are tested with for model exchange, and what exports each of them once."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin
from pathlib import Path
from typing import Any

import mechanisms as loops
import numpy as np
import pytest
from binding import Binary

from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.fmi import export
from mbfmu.mechanics import (
    DistanceCutJoint,
    Floating,
    Gear,
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    Spherical,
    SphericalCutJoint,
    Step,
    Table,
    Translational,
    rod,
)
from mbfmu.modeling.model import as_model
from mbfmu.session.simulation import Settings

G = 9.81


def spatial_four_bar() -> Mechanism:
    """Crank about z and rocker about x, connected by a coupler between two ball joints: a quaternion in a loop."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    first = Revolute(axis="z", start=0.6, rate=1.0, fixed=True)
    crank = m.body("crank", m.ground, first, **rod(mass=1.0, length=0.5))
    hinge = Revolute(axis="x", at=(1.2, 0.0, 0.6), start=0.3)
    rocker = m.body("rocker", m.ground, hinge, mass=1.2, com=(0.0, 0.4, 0.0), inertia=(0.08, 0.01, 0.08))
    ball, com = Spherical(at=(0.5, 0.0, 0.0)), (0.725, 0.05, 0.02)
    coupler = m.body("coupler", crank, ball, mass=1.5, com=com, inertia=(0.02, 0.26, 0.27))
    m.cut("ball", SphericalCutJoint(at_a=(1.45, 0.0, 0.0), at_b=(0.0, 0.8, 0.0)), coupler, rocker)
    return m


def hanging_plate() -> Mechanism:
    """A floating plate, connected to the ground by three rods."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    start = (0.15, -1.0, 0.1, 1.0, 0.0, 0.0, 0.0)
    com = (0.05, -0.05, 0.02)
    plate = m.body("plate", m.ground, Floating(start=start), mass=2.0, com=com, inertia=(0.1, 0.2, 0.15))
    for i in range(3):
        c, s = cos(2.0 * np.pi * i / 3.0), sin(2.0 * np.pi * i / 3.0)
        rod_ = DistanceCutJoint(at_a=(0.6 * c, 0.0, 0.6 * s), at_b=(0.3 * c, 0.0, 0.3 * s), length=1.05)
        m.cut(f"rod{i}", rod_, m.ground, plate)
    return m


def spinning_top() -> Mechanism:
    """A body of equal inertia about y and z, free of forces."""
    m = Mechanism()
    m.body("top", m.ground, Floating(rate=(0.1, 0.2, 0.3, 3.0, 0.2, 4.0)), mass=1.0, inertia=(0.1, 0.2, 0.2))
    return m


def cart() -> Mechanism:
    """A pendulum under a cart whose motion is an input, with a torque as another one."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    along = Input(name="x", unit="m", rate_name="x.rate", acceleration_name="x.acceleration")
    base = m.body("cart", m.ground, Translational(axis="x", drive=along), mass=1.0)
    swing = m.body("pendulum", base, Revolute(start=-1.2), **rod(mass=2.0, length=0.8))
    m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m")), swing)
    m.output("angle", swing.angle())
    m.output("force", base.effort())
    return m


def switched() -> Mechanism:
    """A flywheel that a torque turns from 0.3 s on, and more from 0.7 s to 0.9 s."""
    m = Mechanism()
    wheel = m.body("wheel", m.ground, Revolute(), mass=1.0, inertia=(0.5, 0.5, 0.5))
    m.force("on", JointForce(magnitude=Step(height=2.0, begin=0.3)), wheel)
    m.force("more", JointForce(magnitude=Step(height=1.0, begin=0.7, duration=0.2)), wheel)
    m.output("rate", wheel.rate())
    return m


def pulsed(beyond: str) -> Mechanism:
    """A flywheel at rest, with a pulse of the torque of 4 ms at 7.33 s, by a table."""
    times, values = (0.0, 7.328, 7.33, 7.332, 7.4), (0.0, 0.0, 2.0, 0.0, 0.0)
    m = Mechanism()
    wheel = m.body("wheel", m.ground, Revolute(), mass=1.0, inertia=(0.5, 0.5, 0.5))
    m.force("pulse", JointForce(magnitude=Table(times, values, kind="linear", beyond=beyond)), wheel)
    m.output("rate", wheel.rate())
    return m


def many_loops(
    loops: int, length: float = 1.0, *, torque: bool = False, moved: bool = False, start: float = 1.2
) -> Mechanism:
    """Four-bars side by side, 2 coordinates each, with dampers in their hinges; gear wheels; a ball joint in a spatial
    loop; and outputs of all kinds.

    ``torque``: an input turns the first column from an angle ``start`` (rad; the loops are drawn closed at 1.2), which
    else is driven. ``moved``: another input moves the last foot.
    """
    m, driven = Mechanism(gravity=(0.0, -G, 0.0)), Harmonic(amplitude=0.4, frequency=0.5, mean=1.2)
    turned: dict[str, Any] = {"start": start, "fixed": True} if torque else {"drive": driven}
    column, top = m.body("column0", m.ground, Revolute(**turned), **rod(mass=1.0, length=length)), (length, 0.0, 0.0)
    if torque:
        motor = m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m", start=2.0)), column)
        m.output("effort", motor.effort())
    along = Input(name="x", unit="m", rate_name="x.rate", acceleration_name="x.acceleration")
    base = m.body("base", m.ground, Translational(axis="x", drive=along), mass=1.0) if moved else m.ground
    for i in range(1, loops + 1):
        coupler = m.body(f"coupler{i}", column, Revolute(at=top, start=-1.2), **rod(mass=1.0, length=length))
        hinge = Revolute(at=(length, 0.0, 0.0), start=1.2, armature=0.05 * length**2)
        column = m.body(f"column{i}", coupler, hinge, **rod(mass=1.0, length=-length))
        m.force(f"damper{i}", JointSpring(damping=0.1), coupler)
        feet = {"at_a": (-length, 0.0, 0.0), "at_b": (i * length, 0.0, 0.0)}
        foot = m.cut(f"foot{i}", RevoluteCutJoint(**feet), column, base if i == loops else m.ground)
        top = (0.0, 0.0, 0.0)
    wheel = m.body("wheel", m.ground, Revolute(), mass=1.0, inertia=(0.1, 0.1, 0.1))
    m.couple("gear", Gear(ratio=0.2, offset=0.24), wheel, m.bodies[3 if moved else 2])
    half = {"com": (0.5 * length, 0.0, 0.0), "inertia": (0.01, 0.03, 0.03)}
    arm = m.body("arm", wheel, Spherical(at=(0.0, length, 0.0)), mass=0.3, **half)
    sledge = m.body("sledge", m.ground, Translational(axis="x", at=(0.0, length, 0.0), start=length), mass=0.2)
    m.cut("ball", SphericalCutJoint(at_a=(length, 0.0, 0.0)), arm, sledge)
    m.output("angle", column.angle())
    m.output("bearing", foot.force("x"))
    m.output("pull", sledge.position("x"))
    m.output("acceleration", sledge.acceleration())
    m.output("hinge", coupler.joint_force("y"))
    m.output("energy", m.energy)
    return m


REGULAR: dict[str, tuple[Callable[[], Mechanism], float]] = {  # and how long they are followed, s
    "four-bar": (lambda: loops.grashof(0.2).mechanism, 2.0),
    "spatial four-bar": (spatial_four_bar, 2.0),
    "hanging plate": (hanging_plate, 2.0),
    "redundant": (lambda: loops.bricard().mechanism, 2.0),
    "slewed crane": (lambda: loops.crane().mechanism, 2.0),
    "governor": (lambda: Governor().build(), 0.25),
    "free governor": (lambda: Governor(driven=False).build(), 0.25),
    "pendulum": (lambda: SwingPendulum().build(), 1.0),
}


class ExportedModels:
    """FMUs of models by name and version of FMI, each exported and loaded once."""

    def __init__(self, folders: pytest.TempPathFactory) -> None:
        self._folders = folders
        self._paths: dict[tuple[str, int], Path] = {}
        self._binaries: dict[str, Binary] = {}

    def export(self, name: str, model: Any, fmi: int = 2, solver: str = "adams") -> Path:
        """Return the FMU of a model."""
        if (name, fmi) not in self._paths:
            path = self._folders.mktemp("exchange") / "model.fmu"
            self._paths[name, fmi] = export(as_model(model), path, Settings(solver=solver), native=True, fmi=fmi)
        return self._paths[name, fmi]

    def load(self, name: str, model: Any, solver: str = "adams") -> Binary:
        """Return the library of the FMU for FMI 2.0."""
        if name not in self._binaries:
            path = self.export(name, model, solver=solver)
            self._binaries[name] = Binary(path, path.parent / "unpacked")
        return self._binaries[name]
