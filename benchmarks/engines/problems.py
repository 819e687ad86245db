"""The mechanisms of ``benchmarks/peers.py``: numbers, motion of one degree of freedom as the reference, and times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import mbfmu as mb
from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum

Array = NDArray[np.float64]
Run = Callable[[], Array]  # runs a problem and returns its angle (1001,) at the TIMES, rad
END = 10.0  # s
TIMES = np.linspace(0.0, END, 1001)
GRAVITY = 9.81  # m/s^2
LARGE_INERTIA = 1e9  # kg m^2, of a hub in engines that cannot prescribe its speed: the speed changes by less than 1e-9

FOURBAR, GOVERNOR, PENDULUM = FourBar(), Governor(gravity=0.0), SwingPendulum()


@dataclass(frozen=True)
class Problem:
    """A mechanism.

    Attributes
    ----------
    name
        Its key.
    title
        What pictures call it.
    exact
        Returns the angle that is compared, at the TIMES, rad: by SciPy on an equation of one degree of freedom (two of
        the pendulum) that was derived by hand.
    ours
        Returns the model of this package.
    angle
        Name of the output of this package.
    """

    name: str
    title: str
    exact: Callable[[], Array]
    ours: Callable[[], Any]
    angle: str


def columns(loops: int) -> mb.Mechanism:
    """Four-bars in a row (benchmark A02 of the IFToMM library), declared as a graph: links of 1 m and 1 kg."""
    m, upright, link = mb.Mechanism(gravity=(0.0, -GRAVITY, 0.0)), 0.5 * pi, mb.rod(mass=1.0, length=1.0)
    column = [m.body(f"column{i}", **link) for i in range(loops + 1)]
    beam = [m.body(f"beam{i}", **link) for i in range(loops)]
    for i in range(loops + 1):
        foot = mb.Revolute(at=(float(i), 0, 0), start=upright, rate=-1.0, fixed=i == 0)
        joint = m.joint(f"foot{i}", m.ground, column[i], foot)
        if i == 0:
            m.output("angle", joint.angle(), "Angle of the first column")
    for i in range(loops):
        m.joint(f"left{i}", column[i], beam[i], mb.Revolute(at=(1, 0, 0), start=-upright, rate=1.0))
        m.joint(
            f"right{i}", beam[i], column[i + 1], mb.Revolute(at=(1, 0, 0), start=upright, rate=-1.0), at_b=(1, 0, 0)
        )
    return m


def swing(loops: int) -> Array:
    """Angle of the columns: a pendulum, since all columns remain parallel."""
    inertia, weight = (loops + 1) / 3.0 + loops, (0.5 * (loops + 1) + loops) * GRAVITY

    def slope(_: float, y: Array) -> list[float]:
        return [y[1], -weight / inertia * np.cos(y[0])]

    found = solve_ivp(slope, (0.0, END), [0.5 * pi, -1.0], method="DOP853", t_eval=TIMES, rtol=2.3e-14, atol=1e-14)
    return np.asarray(found.y[0])


def first(model: mb.Model) -> Array:
    """Return the first exact output of a model."""
    exact = model.exact(TIMES)
    assert exact is not None
    return next(iter(exact.values()))


def problems(loops: int) -> dict[str, Problem]:
    """Return the problems by key; ``loops`` of the row of four-bars."""
    found = (
        Problem("fourbar", "four-bar", lambda: first(FOURBAR), lambda: FOURBAR, "crank.angle"),
        Problem("governor", "governor without gravity", lambda: first(GOVERNOR), lambda: GOVERNOR, "arm1.angle"),
        Problem("pendulum", "swing pendulum", lambda: first(PENDULUM), lambda: PENDULUM, "rod.angle"),
        Problem("a02", f"A02, {loops} loops", lambda: swing(loops), lambda: columns(loops), "angle"),
    )
    return {problem.name: problem for problem in found}
