"""Nips next to each other and one behind the other, what they and touches refuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Mechanism, Polynomial, Revolute
from mbfmu.mechanics.tangent import find_groups
from mbfmu.sheets import Drum, Sheet, Wall, add_contact, add_nip, add_sheet
from mbfmu.util.errors import UserError

from .test_contact import PAPER


def driven(speeds: tuple[float, ...], grid: tuple[int, int], **options: Any) -> tuple[Mechanism, Sheet, list[Any]]:
    """A4 paper in nips on one line, 0.1 m apart, without weight."""
    m, R = Mechanism(), 0.01
    mean = sum(speeds) / len(speeds)
    turning = (speeds[-1] - speeds[0]) / 0.1
    sheet = add_sheet(m, "s", at=(-0.197, 0.0, -0.105), grid=grid, rate=(mean, 0.0, 0.0, 0.0, turning, 0.0), **PAPER)
    nips = []
    for i, (z, v) in enumerate(zip(np.linspace(-0.05, 0.05, len(speeds)), speeds, strict=True)):
        axle = Revolute(at=(0.0, -R, z), drive=Polynomial((0.0, -v / R)))
        roller = m.body(f"roller{i}", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
        given = {"radius": R, "at": (0.0, 0.0, z), "width": 1e-3, "force": 2.0, "creep": 0.0, "pairs": 1}
        nips.append(add_nip(m, f"nip{i}", sheet, roller, **(given | options)))
        m.output(f"slip{i}", nips[-1].slip())
        m.output(f"torque{i}", roller.effort())
        m.output(f"traction{i}", nips[-1].traction())
    return m, sheet, nips


def test_two_speeds_skew_a_sheet() -> None:
    """(v2 - v1) / b: 0.1 rad/s, while the nips pass cells."""
    m, sheet, _ = driven((0.30, 0.31), (9, 7))
    ends = sheet.node(4, 0), sheet.node(4, -1)
    for name, end in zip("ab", ends, strict=True):
        m.output(f"{name}.x", end.position("x"))
        m.output(f"{name}.z", end.position("z"))
    found = mb.simulate(m, stop_time=0.2, interval=0.2, solver="esdirk", tolerance=1e-4)
    skew = np.arctan2(found["b.x"] - found["a.x"], found["b.z"] - found["a.z"])
    assert skew[-1] - skew[0] == pytest.approx(0.02, rel=2e-3)


def test_a_sheet_spins_up_a_roller_that_turns_freely() -> None:
    """At mu N R / I while it slips, to the speed of the sheet; which does not make one block of the sheet."""
    speed, radius, inertia = 0.3, 0.01, 1e-5
    m = Mechanism()
    paper = PAPER | {"at": (-0.05, 0.0, -0.105), "rate": (speed, 0.0, 0.0, 0.0, 0.0, 0.0)}
    sheet = add_sheet(m, "paper", grid=(9, 7), **paper)
    for name, x, drive in (("driven", 0.15, Polynomial((0.0, -speed / radius))), ("free", 0.05, None)):
        axle = Revolute(at=(x, -radius, 0.0), drive=drive)
        roller = m.body(name, m.ground, axle, mass=0.1, inertia=(inertia,) * 3)
        add_nip(m, f"{name} nip", sheet, roller, radius=radius, at=(x, 0.0, 0.0), width=0.05, force=2.0)
        m.output(f"{name}.omega", roller.angular_velocity("z"))
    assert len(find_groups(m).inward) == 10
    assert not CompiledMechanism(m).tangent().symmetric
    found = mb.simulate(m, stop_time=0.03, interval=0.005, solver="esdirk", tolerance=1e-4)
    spin = np.minimum(2.0 * radius / inertia * found.t, speed / radius)
    whole = np.arange(len(spin)) != 3  # but where it arrives, which friction that is regularized makes round
    np.testing.assert_allclose(-found["free.omega"][whole], spin[whole], atol=0.01)


def test_an_idler_does_not_pull() -> None:
    """With a negative force, which an input may have, the roller does not change the velocity of the sheet."""
    m, sheet, _ = driven((0.1, 0.1), (5, 4), force="-5")
    m.output("v", sheet.node(0, 0).velocity("x"))
    found = mb.simulate(m, stop_time=0.02, interval=0.01, solver="esdirk", tolerance=1e-4)
    np.testing.assert_allclose(found["v"], 0.1, rtol=1e-6)
    np.testing.assert_allclose(found["torque0"], 0.0, atol=1e-9)


def test_two_nips_in_one_place_are_refused() -> None:
    m, sheet, _ = driven((0.1, 0.1), (5, 4))
    axle = Revolute(at=(0.001, -0.01, -0.05), drive=Polynomial((0.0, -1.0)))
    roller = m.body("third", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
    with pytest.raises(UserError, match=r"nip 'c' at .* and nip 'nip0' at .* are in one place; allowed: 0.02 m apart"):
        add_nip(m, "c", sheet, roller, radius=0.01, at=(0.001, 0.0, -0.05), width=0.02, force=1.0)


def test_what_contact_refuses() -> None:
    m = Mechanism()
    sheet = add_sheet(m, "s", grid=(4, 3), **PAPER)
    roller = m.body("roller", m.ground, Revolute(at=(0.0, -0.01, 0.0), drive=Polynomial((0.0, 1.0))), mass=1.0)
    other = add_sheet(Mechanism(), "other", grid=(4, 3), **PAPER)
    nip: dict[str, Any] = {"radius": 0.01, "at": (0.0, 0.0, 0.0), "width": 0.02, "force": 2.0}
    with pytest.raises(UserError, match=r"friction of contact 't' is -0.1"):
        add_contact(m, "t", sheet, Wall(), friction=-0.1)
    with pytest.raises(UserError, match="sheet of contact 't' is 'other'; allowed: a sheet of this mechanism"):
        add_contact(m, "t", other, Wall())
    with pytest.raises(
        UserError, match=r"too coarse for a surface of contact 't' with a curvature of 50 1/m; allowed: 0.012"
    ):
        add_contact(m, "t", sheet, Drum(radius=0.02, length=1.0))
    with pytest.raises(UserError, match="a node of sheet 's' itself"):
        add_contact(m, "t", sheet, Wall(), body=sheet.node(0, 0))
    with pytest.raises(UserError, match="feed of nip 'n' is 'x'; allowed: a direction normal to its normal 'x'"):
        add_nip(m, "n", sheet, roller, normal="x", **nip)
    with pytest.raises(UserError, match="force of nip 'n' is -2"):
        add_nip(m, "n", sheet, roller, **(nip | {"force": -2.0}))
    with pytest.raises(UserError, match="uneven of nip 'n' is 2"):
        add_nip(m, "n", sheet, roller, uneven=2.0, **nip)
    with pytest.raises(UserError, match="pairs of nip 'n' is 0; allowed: a whole number from 1 to 1000"):
        add_nip(m, "n", sheet, roller, pairs=0, **nip)
    with pytest.raises(UserError, match=r"contact of nip 'n' is 1e-30. m; allowed"):
        add_nip(m, "n", sheet, roller, contact=1e-300, **nip)
    with pytest.raises(UserError, match="stiffness of nip 'n' is 'soft'"):
        add_nip(m, "n", sheet, roller, stiffness="soft", **nip)
    with pytest.raises(UserError, match=r"the axis of 'roller' is 0\.3 m away from its place at roller of nip 'n'"):
        add_nip(m, "n", sheet, roller, **(nip | {"at": (0.3, 0.0, 0.0)}))
    with pytest.raises(UserError, match=r"axis of 'roller' is \[0.0, 0.0, 1.0\]; allowed as roller of nip 'n'"):
        add_nip(m, "n", sheet, roller, feed="z", **nip)
    with pytest.raises(UserError, match=r"roller of nip 'n' is 's\.0\.0'; allowed: a body on a Revolute"):
        add_nip(m, "n", sheet, sheet.node(0, 0), **nip)
    for points in (3, None, (0, 2), (True, 2), (2, 2, 2)):
        with pytest.raises(UserError, match="points of contact 't' are"):
            add_contact(m, "t", sheet, Wall(), points=points)
    add_nip(m, "n", sheet, roller, **nip)
    stray = add_contact(m, "t", sheet, Wall()).depth()
    with pytest.raises(UserError, match="output 'depth' is of 't', which is of another mechanism"):
        Mechanism().output("depth", stray)
    with pytest.raises(UserError, match="load is named 'n'; allowed"):
        add_nip(m, "n", sheet, roller, **nip)
    with pytest.raises(UserError, match="contact stiffness of nips"):
        mb.simulate(m, stop_time=0.1, solver="adams")
