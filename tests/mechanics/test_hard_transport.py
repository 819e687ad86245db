"""Hard cases of sheets in nips and on guides: what enters askew, leaves, stops, drops, rattles, or starts wrong."""

from __future__ import annotations

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import Input, Mechanism, PointForce, Polynomial, Revolute, RunUp, SpeedInput
from mbfmu.sheets import Drum, Guide, Wall, add_contact, add_nip, add_sheet

from .strips import (
    GRAVITY,
    LENGTH,
    RADIUS,
    RUBBER,
    THICKNESS,
    WIDTH,
    add_channel,
    add_driven,
    add_strip,
    carried,
    run,
    sliding,
)
from .test_transport import DOWN, PAPER, at_speed, mass


def test_an_edge_enters_too_high_and_corner_first() -> None:
    """0.5 mm above the nip, and turned by 3 degrees in its plane: the nip takes it in, pulls it down and drives it."""
    m, speed, angle = Mechanism(), 0.3, np.deg2rad(3.0)
    turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    at = turn @ (-0.1, 0.0, -0.015) + (-0.006, 5e-4, 0.0)
    rate = turn.T @ (speed, 0.0, 0.0)
    paper = PAPER | {"length": 0.1, "width": WIDTH}
    sheet = add_sheet(m, "s", grid=(9, 3), at=at, rotation=turn, rate=(*rate, 0.0, 0.0, 0.0), **paper)
    nip, _ = add_driven(m, "nip", sheet, at_speed(speed))
    for k in (0, -1):
        for axis in "xyz":
            m.output(f"{axis}{k}", sheet.node(-1, k).position(axis))
    m.output("loaded", nip.loaded())
    m.output("slip", nip.slip())
    m.output("energy", m.energy)
    found = run(m, 0.1, 1e-3)
    corners = np.array([found["x0"], found["x-1"]])
    assert corners[0, 0] < corners[1, 0] - 1e-3
    assert found["loaded"][0] == 0.0
    assert found["loaded"][-1] == pytest.approx(1.0)
    assert np.all(np.diff(found["loaded"][:31]) >= 0.0)
    np.testing.assert_allclose(np.diff(corners, axis=1)[:, 30:] / 1e-3, speed, rtol=1e-2)
    np.testing.assert_allclose([found["y0"][30:], found["y-1"][30:]], 0.0, atol=2e-5)
    assert found["slip"][30:].max() < 1e-4


def test_torque_of_a_nip_that_a_sheet_leaves_goes_to_zero() -> None:
    """While it is held back; over the way of the entry, without a jump."""
    m, speed, pull = Mechanism(), 0.1, 0.1
    sheet = add_strip(m, 9, 0.096, length=0.1, rate=(speed, 0.0, 0.0, 0.0, 0.0, 0.0))
    nip, roller = add_driven(m, "nip", sheet, at_speed(speed), entry=4e-3)
    m.force("pull", PointForce(magnitude=pull, axis="x"), sheet.node(-1, 1))
    m.output("torque", roller.effort())
    m.output("loaded", nip.loaded())
    found = run(m, 0.07, 2e-5, 1e-5)
    felt = found["torque"] / RADIUS
    assert felt[500:1500].mean() == pytest.approx(pull, rel=1e-2)
    assert np.all(np.abs(felt) <= 2.0 * found["loaded"] + 1e-12)
    assert np.abs(np.diff(felt[100:])).max() < 0.05 * pull
    assert found["loaded"][-1] == felt[-1] == 0.0


def test_a_roller_stops_and_reverses() -> None:
    """Its speed jumps; the sheet follows no faster than friction lets it, mu N / m."""
    m, speed = Mechanism(), 0.3
    sheet = add_strip(m, 9, 0.05, length=0.1, rate=(speed, 0.0, 0.0, 0.0, 0.0, 0.0))
    drive = SpeedInput(name="speed", unit="rad/s", start=-speed / RADIUS)
    nip, _ = add_driven(m, "nip", sheet, drive, force=0.02)
    m.output("v", sheet.node(4, 1).velocity("x"))
    m.output("slip", nip.slip())
    m.output("traction", nip.traction())
    simulation = mb.Simulation(m, mb.Settings(solver="esdirk", tolerance=1e-5))
    names = [v.name for v in simulation.variables]
    rows = []
    for i in range(60):
        if i in (10, 30):
            simulation.set_input("speed", 0.0 if i == 10 else speed / RADIUS)
        assert simulation.advance(1e-3 * (i + 1)).ok
        rows.append(dict(zip(names, simulation.outputs().copy(), strict=True)))
    v = np.array([row["v"] for row in rows])
    most = 0.02 / (0.1 * mass() / LENGTH) * 1e-3  # change in a millisecond
    np.testing.assert_allclose(np.diff(v)[[9, 10, 11, 29, 30, 31]], -most, rtol=2e-3)
    assert v[25] == pytest.approx(0.0, abs=1e-6)
    assert v[-1] == pytest.approx(-speed, rel=1e-6)
    assert max(abs(row["traction"]) for row in rows) < 0.02


def test_a_thin_film_is_fed() -> None:
    """PET of 12 um in air, whose leading edge falls onto a table 2 mm below the nip and is laid there."""
    m, speed = Mechanism(gravity=DOWN), 0.2
    sheet = add_strip(m, 10, 0.02, length=0.05, thickness=12e-6, density=1390.0, damping=5e-3, drag=1.2)
    drive = RunUp(speed=-speed / RADIUS, duration=0.02)
    nip, _ = add_driven(m, "nip", sheet, drive, stiffness=None, contact=None)
    table = add_contact(m, "table", sheet, Wall(at=(0.0, -2e-3, 0.0)), friction=0.3)
    m.output("depth", table.depth())
    m.output("slip", nip.slip())
    for i in range(10):
        m.output(f"y{i}", sheet.node(i, 1).position("y"))
    m.output("x", sheet.node(-1, 1).position("x"))
    found = run(m, 0.05, 1e-3)
    y = np.array([found[f"y{i}"] for i in range(10)])
    assert np.abs(found["slip"]).max() < 1e-4
    assert 0.0 < found["depth"][-1] < 12e-6
    assert y.min() > -2e-3 - 6e-5  # where the edge lands
    assert y[-1, -1] == pytest.approx(-2e-3 + 6e-6, abs=12e-6)
    assert 0.02 + 0.9 * speed * 0.04 < found["x"][-1] < 0.02 + speed * 0.04


def test_a_sheet_is_dropped_on_a_roller() -> None:
    """That turns, with a drum on it: it is taken along the way the roller turns."""
    m, R = Mechanism(gravity=DOWN), 0.03
    sheet = add_strip(m, 13, 0.05, length=0.1)
    axle = Revolute(at=(0.0, -R - 0.5 * THICKNESS - 2e-3, 0.0), drive=at_speed(0.3 * RADIUS / R))
    roller = m.body("roller", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
    contact = add_contact(m, "drum", sheet, Drum(radius=R, length=0.1), body=roller, friction=0.3)
    m.output("x", sheet.node(6, 1).position("x"))
    m.output("y", sheet.node(6, 1).position("y"))
    m.output("vx", sheet.node(6, 1).velocity("x"))
    m.output("force", contact.force("y"))
    m.output("torque", roller.effort())
    m.output("energy", m.energy)
    found = run(m, 0.1, 1e-3)
    landed = np.flatnonzero(found["force"] > 0.0)[0]
    assert found.t[landed] == pytest.approx(np.sqrt(2.0 * 2e-3 / GRAVITY), abs=1.5e-3)
    assert -1e-4 < found["y"][25:60].min() + 2e-3 < 0.0
    # no faster than the roller, which feels no more than friction
    force = found["force"]
    assert 0.1 < found["vx"][70] < 0.3
    assert np.all(np.abs(found["torque"]) <= 1.05 * 0.3 * force * R + 1e-9)


@pytest.mark.parametrize(("width", "pairs"), [(1e-3, 1), (0.04, 2)])
def test_a_misaligned_nip_fights_a_straight_one(width: float, pairs: int) -> None:
    """One 80 mm behind the other and turned by 2 degrees: narrow ones turn the sheet, wide ones slip."""
    m, speed, angles, places = Mechanism(), 0.5, (0.0, np.deg2rad(2.0)), (0.0, 0.08)
    sheet = add_sheet(m, "s", at=(-0.1, 0.0, -0.105), grid=(9, 7), rate=(speed, 0.0, 0.0, 0.0, 0.0, 0.0), **PAPER)
    for k, (x, angle) in enumerate(zip(places, angles, strict=True)):
        feed = np.array((np.cos(angle), 0.0, np.sin(angle)))
        axle = Revolute(axis=np.cross(feed, (0.0, 1.0, 0.0)), at=(x, -RADIUS, 0.0), drive=at_speed(speed))
        roller = m.body(f"roller{k}", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
        given = {"radius": RADIUS, "at": (x, 0.0, 0.0), "width": width, "pairs": pairs, "force": 2.0, "creep": 0.0}
        nip = add_nip(m, f"nip{k}", sheet, roller, feed=feed, contact=1e-3, **given)
        m.output(f"slip{k}", nip.slip())
        m.output(f"lateral{k}", nip.lateral())
    m.output("turning", sheet.node(4, 3).angular_velocity("y"))
    found = run(m, 0.04, 0.01)
    stations = [
        (x + half * np.cos(angle) - z * np.sin(angle), z * np.cos(angle) + half * np.sin(angle), angle, speed)
        for x, angle in zip(places, angles, strict=True)
        for half in (5e-4, -5e-4)
        for z in 0.5 * width * (2.0 * np.arange(pairs) + 1.0 - pairs) / pairs
    ]
    turning = carried(stations, 1e-3)[2]
    assert found["turning"][-1] == pytest.approx(turning, rel=2e-3)
    assert found["lateral0"][-1] == pytest.approx(-found["lateral1"][-1], abs=0.02)
    if pairs > 1:
        assert min(abs(found[f"slip{k}"][-1]) for k in (0, 1)) > 5e-5
    else:
        assert turning == pytest.approx(-speed * np.sin(angles[1]) / places[1], rel=1e-2)


def test_a_sheet_rattles_between_two_guides() -> None:
    """1 mm apart, thrown at 1 m/s with a nose that rises: it stays between them and only loses."""
    m, count = Mechanism(gravity=DOWN), 13
    sheet = add_strip(m, count, 0.05, length=0.1, rate=(1.0, 0.3, 0.0, 0.0, 0.0, 3.0))
    for name, y in (("below", -0.5 * THICKNESS - 1.5e-3), ("above", 0.5 * THICKNESS + 1.5e-3)):
        plate = Guide(start=(-0.5, y, 0.0), end=(0.5, y, 0.0), radius=1e-3, width=0.1)
        add_contact(m, name, sheet, plate, friction=0.2, stiffness=2e6, depth=2e-5)
    for i in range(count):
        m.output(f"y{i}", sheet.node(i, 1).position("y"))
    m.output("vx", sheet.node(6, 1).velocity("x"))
    m.output("energy", m.energy)
    found = run(m, 0.06, 5e-4)
    energy = found["energy"]
    assert np.abs([found[f"y{i}"] for i in range(count)]).max() < 0.5e-3 + THICKNESS
    assert (energy - np.minimum.accumulate(energy)).max() < 1e-3 * energy[0]
    assert abs(found["energy_error"][-1]) < 5e-3 * energy[0]
    assert 0.0 < found["vx"][-1] < 1.0 - 0.2 * GRAVITY * 0.06


def test_a_start_off_the_plane_of_a_nip() -> None:
    """By 0.2 mm: what its rubber and its cell store is in the energy from the start, which only falls."""
    m, off = Mechanism(), 2e-4
    given = {"length": 0.1, "width": WIDTH}
    sheet = add_sheet(m, "s", grid=(9, 3), at=(-0.05, off, -0.5 * WIDTH), **(PAPER | given))
    add_driven(m, "nip", sheet, Polynomial((0.0,)))
    m.output("y", sheet.node(4, 1).position("y"))
    m.output("energy", m.energy)
    found = run(m, 0.05, 2e-5, 1e-5)
    energy = found["energy"]
    assert 0.0 < energy[0] < 0.5 * RUBBER * off**2
    assert (energy - np.minimum.accumulate(energy)).max() < 1e-5 * energy[0]
    assert energy[-1] < 1e-4 * energy[0]
    assert abs(found["y"][-1]) < 1e-6


def test_the_force_of_a_nip_goes_to_zero_and_back() -> None:
    """Meanwhile what pulls at the strip has it alone."""
    m, speed, pull = Mechanism(), 0.3, 0.01
    sheet = add_strip(m, 9, 0.05, length=0.1, rate=(speed, 0.0, 0.0, 0.0, 0.0, 0.0))
    force = Input(name="force", unit="N", start=2.0)
    nip, _ = add_driven(m, "nip", sheet, at_speed(speed), force=force)
    m.force("pull", PointForce(magnitude=pull, axis="x"), sheet.node(0, 1))
    m.output("v", sheet.node(4, 1).velocity("x"))
    m.output("traction", nip.traction())
    found = run(m, 0.02, 1e-3, 1e-5, inputs={"force": lambda t: 0.0 if 0.0045 < t < 0.0095 else 2.0})
    v = found["v"]
    np.testing.assert_allclose(np.diff(v)[5:9], pull / (0.1 * mass() / LENGTH) * 1e-3, rtol=1e-6)
    np.testing.assert_allclose(found["traction"][5:10], 0.0, atol=1e-12)
    np.testing.assert_allclose(v[[4, -1]], speed + 1e-3 * sliding(pull / 2.0), rtol=1e-6)
    np.testing.assert_allclose(found["traction"][[4, -1]], pull, rtol=1e-3)


def test_a_state_in_the_midst_of_contact_is_taken_up() -> None:
    """Of a strip that a nip drives up a guide: by another simulation, and by the same one after a restart."""
    m, speed = Mechanism(gravity=DOWN), 0.3
    sheet = add_strip(m, 13, 0.035, length=0.1)
    nip, roller = add_driven(m, "nip", sheet, RunUp(speed=-speed / RADIUS, duration=0.01))
    add_channel(m, sheet)
    contact = add_contact(m, "guide", sheet, Wall(at=(0.04, 0.0, 0.0), normal=(-1.0, 1.0, 0.0)), friction=0.2)
    m.output("x", sheet.node(-1, 1).position("x"))
    m.output("y", sheet.node(-1, 1).position("y"))
    m.output("slip", nip.slip())
    m.output("torque", roller.effort())
    m.output("force", contact.force("y"))
    settings = mb.Settings(solver="esdirk", tolerance=1e-5)
    one, two, three = (mb.Simulation(m, settings) for _ in range(3))
    assert one.advance(0.04).ok
    assert one.outputs()[4] > 0.0
    state = one.save()
    two.restore(state)
    three.restore(state)
    three.stepper.restart()
    ends = []
    for simulation in (one, two, three):
        assert simulation.advance(0.06).ok
        ends.append(simulation.outputs().copy())
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_allclose(ends[2][:2], ends[0][:2], atol=1e-5)
