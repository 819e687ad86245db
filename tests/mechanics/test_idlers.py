"""Idlers of nips that are bodies, which a sheet turns by friction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Body, Mechanism, PointForce, Polynomial, Revolute
from mbfmu.sheets import add_nip

from .strips import DENSITY, LENGTH, RADIUS, THICKNESS, WIDTH, add_driven, add_strip, run, sliding

MASS = LENGTH * WIDTH * THICKNESS * DENSITY  # of a strip, kg


def idling(m: Mechanism, inertia: float, rate: float = 0.0, radius: float = 0.008) -> Body:
    """A body beyond a nip at x = 0."""
    axle = Revolute(at=(0.0, radius, 0.0), axis=(0.0, 0.0, 1.0), rate=rate)
    return m.body("idler", m.ground, axle, mass=0.1, inertia=(inertia, inertia, inertia))


def test_a_roller_speeds_up_the_idler_too() -> None:
    """By the sheet between them, evenly: what pulls at it is (m + I / R^2) a of sheet and idler, the idler's part of it
    by friction, so that it slips by as much as that takes.
    """
    m, a, inertia, R, mu, N = Mechanism(), 2.0, 2e-6, 0.008, 0.3, 2.0
    sheet = add_strip(m, 7, 0.1)
    idler = idling(m, inertia, radius=R)
    nip, _ = add_driven(
        m, "nip", sheet, Polynomial((0.0, 0.0, -0.5 * a / RADIUS)), idler=idler, idler_radius=R, idler_friction=mu
    )
    m.output("traction", nip.traction())
    m.output("idler", idler.rate())
    m.output("v", sheet.node(3, 1).velocity("x"))
    found = run(m, 0.05, 0.01, 1e-5)
    share = inertia / R**2 * a / (mu * N)
    assert 0.05 < share < 0.2
    assert -found["traction"][-1] == pytest.approx((MASS + inertia / R**2) * a, rel=2e-3)
    assert found["v"][-1] - R * found["idler"][-1] == pytest.approx(1e-3 * sliding(share), rel=1e-2)


def test_an_idler_that_rests_is_spun_up_by_the_sheet() -> None:
    """With mu N R / I, until it turns as the sheet moves."""
    m, v, inertia, R, mu, N = Mechanism(), 0.3, 2e-5, 0.008, 0.3, 2.0
    sheet = add_strip(m, 7, 0.1, rate=(v, 0.0, 0.0, 0.0, 0.0, 0.0))
    idler = idling(m, inertia, radius=R)
    add_driven(m, "nip", sheet, Polynomial((0.0, -v / RADIUS)), idler=idler, idler_radius=R, idler_friction=mu)
    m.output("idler", idler.rate())
    rise = mu * N * R / inertia
    found = run(m, 1.3 * v / R / rise, 0.1 * v / R / rise, 1e-5)
    np.testing.assert_allclose(found["idler"][1:9], rise * found.t[1:9], rtol=2e-3)
    assert found["idler"][-1] == pytest.approx(v / R, rel=1e-3)


@pytest.mark.parametrize("solver", ["ida", "esdirk"])
@pytest.mark.parametrize(("rolling", "idle"), [(1e-3, 1e-9), (1e-9, 1e-3), (3e-6, 2e-6)])
def test_a_sheet_is_pulled_between_a_roller_and_an_idler_that_turn_freely(
    rolling: float, idle: float, solver: str
) -> None:
    """Two nips on the same two bodies, of unlike inertia; against three rigid bodies with the same friction (SciPy)."""
    m, pull, mu, beside, N, R = Mechanism(), 0.5, 1.0, 0.3, 2.0, 0.008
    sheet = add_strip(m, 7, 0.1)
    axle = Revolute(at=(0.0, -RADIUS, 0.0))
    roller = m.body("roller", m.ground, axle, mass=0.05, inertia=(rolling, rolling, rolling))
    idler = idling(m, idle, radius=R)
    common = {"force": 0.5 * N, "width": 0.4 * WIDTH, "creep": 0.0, "idler_friction": beside, "idler_radius": R}
    for k, z in enumerate((-0.25 * WIDTH, 0.25 * WIDTH)):
        at = (0.0, 0.0, z)
        add_nip(m, f"nip{k}", sheet, roller, radius=RADIUS, at=at, idler=idler, friction=mu, **common)  # type: ignore[arg-type]
    m.force("pull", PointForce(magnitude=pull, axis="x"), sheet.node(3, 1))
    m.output("v", sheet.node(3, 1).velocity("x"))
    m.output("roller", roller.rate())
    m.output("idler", idler.rate())

    def rates(_: float, y: Any) -> Any:
        slips = np.array((y[0] + RADIUS * y[1], y[0] - R * y[2]))
        below, above = -np.array((mu, beside)) * N * slips / np.hypot(slips, 1e-3)
        return (pull + below + above) / MASS, RADIUS * below / rolling, -R * above / idle

    known = solve_ivp(rates, (0.0, 0.03), np.zeros(3), method="Radau", rtol=1e-9, atol=1e-12).y[:, -1]
    found = run(m, 0.03, 0.01, 1e-5, solver)
    np.testing.assert_allclose([found[name][-1] for name in ("v", "roller", "idler")], known, rtol=2e-3)
