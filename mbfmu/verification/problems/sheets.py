"""Sheets: strip with a load at its tip, and friction of a strip about a drum."""

from __future__ import annotations

from functools import partial
from math import exp, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Mechanism, PointForce, Ramp, Revolute, RunUp
from mbfmu.session.run import simulate
from mbfmu.sheets import Drum, Sheet, Support, add_contact, add_nip, add_sheet
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.verification.problem import Source, Value

from .steady import BISSHOPP, elastica_tip

Array = NDArray[np.float64]
STRIP: dict[str, Any] = {"width": 0.03, "thickness": 1e-4, "poisson": 0.0, "density": 800.0}  # m, m, -, kg/m^3
STRIP_LENGTH, STRIP_MODULUS, STRIP_NODES = 0.1, 4e9, (9, 17)  # m, Pa, coarse and fine mesh
STRIP_BENDING = STRIP_MODULUS * STRIP["width"] * STRIP["thickness"] ** 3 / 12.0  # N m^2
SHARES = (0.25, 0.5, 0.25)  # of a load on the three nodes of an edge
STRIP_LOADS = (1.0, 5.0)  # P L^2 / E I


def loaded_strip(load: float, nodes: int = STRIP_NODES[1]) -> Mechanism:
    """Return a strip that is clamped at one end, with a dead load across the other."""
    m = Mechanism()
    options = {"length": STRIP_LENGTH, "youngs_modulus": STRIP_MODULUS, **STRIP}
    sheet = add_sheet(m, "strip", grid=(nodes, 3), supports=[Support("x0")], membrane=True, **options)
    force = load * STRIP_BENDING / STRIP_LENGTH**2
    for k, share in enumerate(SHARES):
        m.force(f"load{k}", PointForce(magnitude=-share * force, axis="y"), sheet.node(-1, k))
    for axis in "xy":
        m.output(axis, sheet.node(-1, 1).position(axis), f"Coordinate {axis} of the tip")
    return m


def strip_tip(m: Mechanism) -> Array:
    """Return the coordinates of the tip by the length of the strip."""
    outputs = equilibrium(m).outputs
    return np.array((outputs["x"], outputs["y"])) / STRIP_LENGTH


def refined_tip(load: float, m: Mechanism) -> Array:
    """Return the coordinates of the tip, extrapolated from two meshes."""
    return (4.0 * strip_tip(m) - strip_tip(loaded_strip(load, STRIP_NODES[0]))) / 3.0


DRUM_RADIUS, ROLLER_RADIUS, DRUM_FRICTION, PULL, FEED = 0.03, 0.01, 0.3, 0.1, 0.03  # m, m, -, N, m/s


def strip_on_drum() -> Mechanism:
    """Return a strip of small stiffness, drawn by a nip over a quarter of a fixed drum, with a load at its end."""
    m = Mechanism()
    length, out, width = 0.14, 0.09, STRIP["width"]
    sheet: Sheet = add_sheet(
        m,
        "strip",
        length=length,
        youngs_modulus=4e7,
        at=(out - length, 0.0, -0.5 * width),
        grid=(31, 3),
        tree="master",
        membrane=True,
        damping=5e-3,
        drag=20.0,
        **STRIP,
    )
    axle = Revolute(at=(-DRUM_RADIUS, -ROLLER_RADIUS, 0.0), drive=RunUp(speed=FEED / ROLLER_RADIUS, duration=0.02))
    roller = m.body("roller", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
    at = (-DRUM_RADIUS, 0.0, 0.0)
    options = {"width": width, "force": 2.0, "contact": 1e-3, "stiffness": 8e3, "creep": 0.0}
    nip = add_nip(m, "nip", sheet, roller, radius=ROLLER_RADIUS, at=at, **options)
    drum = Drum(radius=DRUM_RADIUS, length=0.1, at=(0.0, -DRUM_RADIUS - 0.5 * STRIP["thickness"], 0.0))
    add_contact(m, "drum", sheet, drum, points=(4, 3), friction=DRUM_FRICTION, stiffness=5e6, depth=2e-5)
    for k, share in enumerate(SHARES):
        pull = PointForce(magnitude=Ramp(height=share * PULL, duration=0.05), axis=(0.0, -1.0, 0.0))
        m.force(f"load{k}", pull, sheet.node(-1, k))
    m.output("traction", nip.traction())
    return m


def tension_ratio(m: Mechanism) -> Array:
    """Return the tension before the drum by the load behind it, mean of the last 0.04 s of 0.12 s."""
    found = simulate(m, 0.12, interval=1e-3, solver="esdirk", tolerance=1e-4)
    return np.array([found["traction"][-40:].mean() / PULL])


SHEET_PROBLEMS = (
    *(
        Value(
            name=f"strip, P L2/EI = {load:g}",
            description=f"Strip of 17 x 3 nodes, clamped at one end, with a dead load across the other, P L^2 / E I = "
            f"{load:g}; extrapolated from 9 and 17 nodes along the strip.",
            sources=(BISSHOPP,),
            quantity="Coordinates of the tip by the length",
            unit="1",
            derivation="closed form (elliptic integrals)",
            build=partial(loaded_strip, load),
            measure=partial(refined_tip, load),
            method="equilibrium",
            reference=partial(elastica_tip, load),
            allowed=2e-3,
            is_quick=False,
        )
        for load in STRIP_LOADS
    ),
    Value(
        name="capstan",
        description="Strip of small stiffness, drawn at 30 mm/s over a quarter of a fixed drum of 30 mm with a "
        "coefficient of friction of 0.3, load of 0.1 N; mean of 40 ms.",
        sources=(
            Source(
                "L. Euler",
                1769,
                "Remarques sur l'effet du frottement dans l'équilibre. Mémoires de l'académie des sciences de Berlin "
                "18, 265-278",
            ),
        ),
        quantity="Ratio of the tensions",
        unit="1",
        derivation="exp(mu pi / 2)",
        build=strip_on_drum,
        measure=tension_ratio,
        method="esdirk",
        reference=lambda: np.array([exp(0.5 * pi * DRUM_FRICTION)]),
        allowed=2e-2,
        is_quick=False,
    ),
)
