"""Stops of native FMUs that hold joints of loops, in co-simulation and in model exchange."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.fmi.export import export
from mbfmu.modeling.model import as_model

pytestmark = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
G, STOP, SLIDER, SIDE, TOLERANCE = 9.81, 0.1, 2.0, 0.5, 1e-8  # m/s^2, m, kg, m
END, RESTS = 3.8, 0.6  # s: end of the runs, and time at which all bounces have ended


def slider_crank(restitution: float, weights: int) -> mb.Mechanism:
    """Return a slider that falls on a stop, with a crank and a rod of 1 kg and 1 m each. A force of G t in N lifts it.

    There are also weights on springs.
    """
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    slider = m.body("slider", m.ground, mb.Translational(axis="y", start=0.3, fixed=True), mass=SLIDER)
    crank = m.body("crank", m.ground, mb.Revolute(at=(SIDE, 0.0, 0.0), start=2.5), **mb.rod(mass=1.0, length=1.0))
    rod = m.body("rod", crank, mb.Revolute(at=(1.0, 0.0, 0.0)), **mb.rod(mass=1.0, length=1.0))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(1.0, 0.0, 0.0), at_b=(0.0, 0.0, 0.0)), rod, slider)
    m.force("lift", mb.JointForce(mb.Polynomial((0.0, G))), slider)
    m.event("stop", slider.coordinate(), crosses=STOP, direction="down", then=mb.Bounce(restitution))
    for k in range(weights):
        weight = m.body(f"weight{k}", m.ground, mb.Translational(axis="x", start=0.1, nominal=1.0), mass=1.0)
        m.force(f"weight{k}", mb.JointSpring(stiffness=1.0 + 0.1 * k), weight)
    m.output("height", slider.coordinate())
    m.output("rate", slider.rate())
    m.output("force", slider.effort())
    m.output("crank", crank.angle())
    return m


def places(y: complex) -> Any:
    """Return the coordinates of the centers of crank and rod, and their angles, at a height of the slider: the three
    sides of the triangle are 1 m, 1 m and the distance from the slider to the axis of the crank.
    """
    distance = np.sqrt(SIDE**2 + y * y)
    crank = np.pi - np.arctan(y / SIDE) - np.arccos(0.5 * distance)
    pin = np.array([SIDE + np.cos(crank), np.sin(crank)])
    rod = np.pi - np.arctan((pin[1] - y) / pin[0])
    return np.array([0.5 * (SIDE + pin[0]), 0.5 * pin[1], 0.5 * pin[0], 0.5 * (pin[1] + y), crank, rod])


def inertia_and_load(y: float) -> tuple[float, float]:
    """Return the inertia of the mechanism at the slider, kg, and the force of gravity against it, N."""
    slopes = np.imag(places(y + 1e-30j)) / 1e-30
    inertia = SLIDER + slopes[:4] @ slopes[:4] + slopes[4:] @ slopes[4:] / 12.0
    return float(inertia), float(G * (SLIDER + slopes[1] + slopes[3]))


@cache
def lifted() -> tuple[float, Any]:
    """Return the time at which the force exceeds the load, and the motion after it: I y'' + I' y'^2 / 2 + V' = G t."""
    start, step = inertia_and_load(STOP)[1] / G, 1e-5

    def slope(t: float, x: Any) -> list[float]:
        inertia, load = inertia_and_load(x[0])
        growth = (inertia_and_load(x[0] + step)[0] - inertia_and_load(x[0] - step)[0]) / (2.0 * step)
        return [x[1], (G * t - load - 0.5 * growth * x[1] ** 2) / inertia]

    return start, solve_ivp(slope, (start, END), [STOP, 0.0], rtol=1e-10, atol=1e-12, dense_output=True).sol


def check(path: Path, kind: str, interval: float) -> None:
    """Compare a run with the closed forms of rest and release, and with SciPy after it."""
    rows = simulate_fmu(
        str(path), stop_time=END, output_interval=interval, output=["height", "rate", "force", "crank"], fmi_type=kind,
        relative_tolerance=1e-9 if kind == "ModelExchange" else None, record_events=False,
    )  # fmt: skip
    start, motion = lifted()
    load, angle = inertia_and_load(STOP)[1], places(STOP)[4]
    held = 0
    for row in rows[rows["time"] > RESTS]:
        t = row["time"]
        if t < start:
            held += 1
            assert (row["height"], row["rate"]) == (STOP, 0.0)
            assert row["force"] == pytest.approx(load - G * t, abs=1e-8)
            assert row["crank"] == pytest.approx(angle, abs=1e-9)
        else:
            assert row["height"] == pytest.approx(motion(t)[0], abs=1e-5)
            assert row["force"] == pytest.approx(0.0, abs=1e-8)
    assert held >= 3
    assert motion(END)[0] > 1.0


@pytest.mark.parametrize("restitution", [0.0, 0.3])
@pytest.mark.parametrize("solver", ["adams", "radau", "ida"])
def test_a_stop_holds_a_slider_crank(solver: str, restitution: float, tmp_path: Path) -> None:
    """The held slider leaves the loop no degree of freedom."""
    settings = mb.Settings(solver=solver, tolerance=TOLERANCE)
    path = export(as_model(slider_crank(restitution, 0)), tmp_path / "loop.fmu", settings, native=True)
    for kind, interval in (("CoSimulation", 0.1), ("ModelExchange", 0.02), ("ModelExchange", 0.5)):
        check(path, kind, interval)


@pytest.mark.campaign
@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_stop_holds_a_slider_crank_of_a_large_model(solver: str, tmp_path: Path) -> None:
    """Its constraints are eliminated along the tree."""
    settings = mb.Settings(solver=solver, tolerance=TOLERANCE)
    path = export(as_model(slider_crank(0.3, 70)), tmp_path / "loop.fmu", settings, native=True)
    for kind, interval in (("CoSimulation", 0.5), ("ModelExchange", 0.5)):
        check(path, kind, interval)
