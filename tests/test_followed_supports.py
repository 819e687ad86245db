"""Steady states of strips whose clamps have come together, against an elastica under gravity (SciPy)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_bvp

import mbfmu as mb

LENGTH, WIDTH, THICKNESS, E, DENSITY = 0.3, 0.02, 5e-5, 4e9, 1000.0


def strip(moved: float, gravity: float, size: float = 1.0, thickness: float = THICKNESS) -> mb.Mechanism:
    """A strip clamped at both ends, of which one has moved in; ``size`` scales lengths."""
    m = mb.Mechanism(gravity=(0.0, -gravity, 0.0))
    push = mb.Translational(axis="x", drive=mb.Step(height=-moved * size, begin=0.0, duration=0.5))
    body = m.body("moved", m.ground, push)
    sheet = mb.add_sheet(
        m, "strip", length=LENGTH * size, width=WIDTH * size, thickness=thickness * size, youngs_modulus=E, poisson=0.0,
        density=DENSITY, grid=(21, 2), stretch=True, supports=[mb.Support("x0"), mb.Support("x1", body=body)],
    )  # fmt: skip
    m.output("sag", sheet.node(10, 0).position("y"))
    return m


def sag(moved: float, gravity: float, thickness: float = THICKNESS) -> float:
    """Deflection of the middle of an inextensible strip: half of it, from the clamp to where it is level again."""
    D, weight = E * thickness**3 / 12.0, DENSITY * thickness * gravity
    half = 0.5 * LENGTH

    def slope(s: Any, y: Any, p: Any, share: float) -> Any:
        _, _, angle, moment = y
        shear = weight * (half - s)  # less the vertical force in the strip; p: the horizontal one
        return np.array(
            [np.cos(angle), np.sin(angle), moment / D, p[0] * np.sin(angle) + share * shear * np.cos(angle)]
        )

    def ends(a: Any, b: Any, p: Any) -> Any:
        return np.array([a[0], a[1], a[2], b[2], b[0] - half + 0.5 * moved])

    s = np.linspace(0.0, half, 201)
    deep = 2.0 / np.pi * np.sqrt(moved * LENGTH)
    guess = np.array(
        [s, -0.5 * deep * (1.0 - np.cos(np.pi * s / half)), -0.5 * deep * np.pi / half * np.sin(np.pi * s / half),
         -0.5 * D * deep * (np.pi / half) ** 2 * np.cos(np.pi * s / half)]
    )  # fmt: skip
    force = np.array([-D * (np.pi / half) ** 2])
    for share in np.linspace(0.0, 1.0, 11):  # of the weight
        found = solve_bvp(partial(slope, share=share), ends, s, guess, p=force, tol=1e-6, max_nodes=20000)
        assert found.success, found.message
        guess, force = found.sol(s), found.p
    return float(found.sol(half)[1])


@pytest.mark.parametrize("moved", [3e-3, 30e-3])
def test_a_strip_sags_between_clamps_that_came_together(moved: float) -> None:
    found = mb.equilibrium(strip(moved, 9.81))
    assert found.stability == "undamped"
    assert found.outputs["sag"] == pytest.approx(sag(moved, 9.81), rel=0.015)
    assert "following their motion" in found.found_from


def test_a_strip_without_weight_buckles() -> None:
    """By the bifurcation, to either side."""
    found = mb.equilibrium(strip(5e-3, 0.0))
    assert found.stability in ("undamped", "neutral")
    assert abs(found.outputs["sag"]) == pytest.approx(-sag(5e-3, 0.0), rel=0.015)


def test_a_strip_pulled_taut_is_found_from_its_start() -> None:
    found = mb.equilibrium(strip(-1e-4, 9.81))
    assert found.stability == "undamped"
    assert found.found_from.startswith("the model")
