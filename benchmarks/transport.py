"""Strips in nips and on guides against the elastica: ``python benchmarks/transport.py [CASE ...] [--nodes N ...]``.

Paper of 80 g/m^2, 30 mm wide, E = 4 GPa, not contracting across; ``esdirk``. A nip with stations at +-c along the feed
is a clamp c / 3 ahead of its middle, from where lengths are counted. Cases:

* ``hang``: at rest out of a nip. Tip of the elastica with weight (a two-point boundary-value problem).
* ``feed``: fed from rest, from 50 mm, flat. Tip from Lagrange's equations of a strip with a moving end.
* ``guide``: fed at 0.1 m/s onto a guide of 45 degrees. What that feels, and what the roller holds back with, which is
  how the energy of the elastica changes with its length; means over a millimeter.
* ``friction``: the same with friction on the guide.
* ``buckle``: two nips, the first faster. Height and thrust of the elastica without weight (elliptic integrals).
* ``capstan``: drawn and fed over a quarter of a fixed drum, with a hundredth of the stiffness. exp(mu pi / 2).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np

from mbfmu.mechanics import Body, Mechanism, PointForce, Polynomial, Ramp, Revolute, RunUp, Signal
from mbfmu.session.result import Result
from mbfmu.session.run import simulate
from mbfmu.sheets import Drum, Guide, NipHandle, Sheet, Support, Wall, add_contact, add_nip, add_sheet
from mbfmu.util.text_table import format_table

LENGTH, WIDTH, THICKNESS, RADIUS = 0.297, 0.03, 1e-4, 0.01
BENDING = 4e9 * THICKNESS**3 / 12.0  # N m
CLAMP = 0.5e-3 / 3.0  # m, ahead of the middle of a nip
UP = np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0)
DOWN = (0.0, -9.81, 0.0)

HANGS = {0.05: (49.961, -1.837), 0.1: (95.535, -27.610), 0.15: (108.963, -95.806), 0.2: (92.429, -164.355),
         0.25: (74.902, -222.240)}  # fmt: skip
FEEDS = {  # m/s: lengths in m, tips in mm
    0.5: {0.1: (98.308, -17.168), 0.15: (130.827, -68.653), 0.2: (129.677, -142.332), 0.25: (99.083, -214.460)},
    1.0: {0.15: (144.893, -36.458), 0.25: (207.286, -132.021)},
}
GUIDES = {0.06015: (0.10763, 0.0488), 0.0801: (0.09066, 0.0367), 0.09606: (0.07928, 0.0353)}  # m: N/m, N/m
RUBS = {0.2: 0.09613, 0.4: 0.10226}  # friction: N/m across the guide at 80.1 mm
BUCKLES = {  # m/s: m too long: mm, N/m
    0.002: {1e-4: (2.0135, 1.31398)},
    0.02: {1e-3: (6.3781, 1.29644), 5e-3: (14.3681, 1.22281), 1e-2: (20.5057, 1.13966)},
}

Row = tuple[str, ...]


def strip(m: Mechanism, nodes: int, out: float, **options: Any) -> Sheet:
    """A strip, ``out`` m of it beyond x = 0."""
    given = {
        "length": LENGTH, "width": WIDTH, "thickness": THICKNESS, "youngs_modulus": 4e9, "poisson": 0.0,
        "density": 800.0, "grid": (nodes, 3), "tree": "master", "membrane": True, "damping": 5e-4,
    } | options  # fmt: skip
    return add_sheet(m, "strip", at=(out - given["length"], 0.0, -0.5 * WIDTH), **given)


def drive(m: Mechanism, sheet: Sheet, signal: Signal, x: float = 0.0, **options: Any) -> tuple[NipHandle, Body]:
    """A nip at x and its roller."""
    axle, name = Revolute(at=(x, -RADIUS, 0.0), drive=signal), f"nip{x:g}"
    roller = m.body(f"{name}.roller", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
    given = {"radius": RADIUS, "width": WIDTH, "force": 2.0, "contact": 1e-3, "stiffness": 8e5} | options
    return add_nip(m, name, sheet, roller, at=(x, 0.0, 0.0), **given), roller


def channel(m: Mechanism, sheet: Sheet) -> None:
    """Guides behind x = 0."""
    for name, y in (("below", -0.5 * THICKNESS - 1.02e-3), ("above", 0.5 * THICKNESS + 1.3e-3)):
        plate = Guide(start=(-0.5, y, 0.0), end=(-2e-3, y, 0.0), radius=1e-3, width=0.1)
        add_contact(m, name, sheet, plate, points=(6, 3), stiffness=2e6, depth=2e-5)


def tell(m: Mechanism, sheet: Sheet) -> None:
    """Outputs of the middle of both edges."""
    for axis in "xy":
        m.output(f"tip.{axis}", sheet.node(-1, 1).position(axis))
        m.output(f"tail.{axis}", sheet.node(0, 1).position(axis))


def run(m: Mechanism, stop_time: float, interval: float, tolerance: float, **options: Any) -> tuple[Result, str]:
    """A run and its CPU time, s."""
    begin = time.process_time()
    found = simulate(m, stop_time, interval=interval, solver="esdirk", tolerance=tolerance, **options)
    if found.failure:
        raise RuntimeError(found.failure)
    return found, f"{time.process_time() - begin:.1f}"


def tips(case: str, known: tuple[float, float], x: float, y: float, took: str) -> Row:
    """A row about a tip, mm."""
    off = np.hypot(x - known[0], y - known[1])
    return case, f"{known[0]:.3f} {known[1]:.3f} mm", f"{x:.3f} {y:.3f}", f"{off:.2f} mm", took


def ratio(case: str, known: float, found: float, unit: str, took: str) -> Row:
    """A row about a number."""
    return case, f"{known:.5g} {unit}".strip(), f"{found:.5g}", f"{100.0 * (found / known - 1.0):+.2f} %", took


def hang(grids: list[int]) -> Iterator[Row]:
    """Statics; the tail is clamped, and rubber so hard that it does not count."""
    for nodes in grids or [19, 37]:
        for length, known in HANGS.items():
            m, whole = Mechanism(gravity=DOWN), length + 0.03
            held = {"tree": "spine", "supports": [Support("x0", "clamped")]}
            sheet = strip(m, nodes, length + CLAMP, length=whole, **held)
            drive(m, sheet, Polynomial((0.0,)), stiffness=1e7)
            tell(m, sheet)
            found, took = run(m, 1e-6, 1e-6, 1e-4, start_at_equilibrium=True)
            x, y = 1e3 * (found["tip.x"][-1] - CLAMP), 1e3 * found["tip.y"][-1]
            yield tips(f"{nodes} x 3, {1e3 * length:.0f} mm", known, x, y, took)


def feed(grids: list[int]) -> Iterator[Row]:
    """Run up in 40 ms."""
    for nodes in grids or [19, 37]:
        for speed, lengths in FEEDS.items():
            m = Mechanism(gravity=DOWN)
            sheet = strip(m, nodes, 0.05 + CLAMP)
            drive(m, sheet, RunUp(speed=-speed / RADIUS, duration=0.04))
            channel(m, sheet)
            tell(m, sheet)
            found, took = run(m, 0.02 + 0.201 / speed, 5e-4, 1e-4)
            for length, known in lengths.items():
                out = LENGTH + found["tail.x"] - CLAMP
                x, y = (1e3 * np.interp(length, out, found[f"tip.{axis}"]) for axis in "xy")
                yield tips(f"{nodes} x 3, {speed} m/s, {1e3 * length:.0f} mm", known, x - 1e3 * CLAMP, y, took)


def risen(nodes: int, friction: float, last: float) -> tuple[Any, ...]:
    """Nip at x = 0, a channel behind it, a guide that rises from x = 40 mm, until a length is fed.

    Returns lengths (m), force across and along the guide and what holds back (N/m), and the CPU time.
    """
    m, speed, start = Mechanism(gravity=DOWN), 0.1, 0.03
    sheet = strip(m, nodes, start, rate=(speed, 0.0, 0.0, 0.0, 0.0, 0.0))
    nip, _ = drive(m, sheet, Polynomial((0.0, -speed / RADIUS)))
    channel(m, sheet)
    wall = Wall(at=np.array([0.04, 0.0, 0.0]) - 0.5 * THICKNESS * UP, normal=UP)
    guide = add_contact(m, "guide", sheet, wall, points=(6, 3), stiffness=2e6, depth=2e-5, friction=friction)
    for axis in "xy":
        m.output(f"guide.{axis}", guide.force(axis))
    m.output("traction", nip.traction())
    tell(m, sheet)
    found, took = run(m, (last - start) / speed + 1e-2, 2e-4, 1e-5)
    force = np.array([found["guide.x"], found["guide.y"]]) / WIDTH
    return LENGTH + found["tail.x"], UP[:2] @ force, force.sum(0) / np.sqrt(2.0), -found["traction"] / WIDTH, took


def guide(grids: list[int]) -> Iterator[Row]:
    """Without friction."""
    for nodes in grids or [25]:
        fed, across, _, back, took = risen(nodes, 0.0, max(GUIDES))
        for length, (force, held) in GUIDES.items():
            near, case = abs(fed - length) < 0.5e-3, f"{nodes} x 3, {1e3 * length:.1f} mm"
            yield ratio(f"{case}, force", force, across[near].mean(), "N/m", took)
            yield ratio(f"{case}, held back", held, back[near].mean(), "N/m", took)


def friction(grids: list[int]) -> Iterator[Row]:
    """The whole force is sqrt(1 + mu^2) times that across while the tip slides."""
    for nodes in grids or [25]:
        for mu, known in RUBS.items():
            fed, across, along, _, took = risen(nodes, mu, 0.0801)
            near, case = abs(fed - 0.0801) < 0.5e-3, f"{nodes} x 3, mu {mu}, 80.1 mm"
            yield ratio(f"{case}, force across", known, across[near].mean(), "N/m", took)
            whole = np.hypot(across, along)[near] / across[near]
            yield ratio(f"{case}, whole to across", np.sqrt(1.0 + mu**2), whole.mean(), "", took)


def buckle(grids: list[int]) -> Iterator[Row]:
    """100 mm between the clamps. What a roller feels is the thrust less M^2 / (2 B); means over 40 ms, or 10."""
    for nodes, (speed, cases) in product(grids or [19, 37], BUCKLES.items()):
        m, apart = Mechanism(), 0.1 + 2.0 * CLAMP
        sheet = strip(m, nodes, apart + 0.01, length=0.15, damping=2e-3, curl=(0.05, 0.0))
        first, _ = drive(m, sheet, RunUp(speed=-speed / RADIUS, duration=0.1))
        drive(m, sheet, Polynomial((0.0,)), x=apart)
        m.output("traction", first.traction())
        for i in range(nodes):
            for axis in "xy":
                m.output(f"{axis}{i}", sheet.node(i, 1).position(axis))
        tell(m, sheet)
        tolerance, near_by = (1e-5, 0.005) if speed < 0.01 else (1e-4, 0.02)  # s; forces are rough at 1e-4
        found, took = run(m, 0.1 + max(cases) / speed, 1e-3, tolerance)
        excess = found["tail.x"] - found["tip.x"] + 0.15
        x, y = (np.array([found[f"{axis}{i}"] for i in range(nodes)]) for axis in "xy")
        for e, (height, thrust) in cases.items():
            near = np.flatnonzero(abs(excess - e) < near_by * speed)
            tops = []
            for j in near:
                i = np.argmax(abs(y[:, j]))
                c = np.polyfit(x[i - 1 : i + 2, j] - x[i, j], abs(y[i - 1 : i + 2, j]), 2)
                tops.append(1e3 * (c[2] - c[1] ** 2 / (4.0 * c[0])))
            case = f"{nodes} x 3 of 150 mm, {1e3 * e:g} mm too long"
            yield ratio(f"{case}, height", height, float(np.mean(tops)), "mm", took)
            moment = 0.5e-3 * thrust * height
            felt = float(np.mean(-found["traction"][near])) / WIDTH + moment**2 / (2.0 * BENDING)
            yield ratio(f"{case}, thrust", thrust, felt, "N/m", took)


def capstan(grids: list[int]) -> Iterator[Row]:
    """The weight on the strip pulls down; it swings into place within 0.1 s."""
    for nodes in grids or [41]:
        for way, speed in (("drawn", -0.03), ("fed", 0.03)):
            m, load = Mechanism(), 0.1
            sheet = strip(m, nodes, 0.1, length=0.16, youngs_modulus=4e7, damping=5e-3, drag=20.0)
            nip, _ = drive(m, sheet, RunUp(speed=-speed / RADIUS, duration=0.02), x=-0.03, stiffness=8e3)
            drum = Drum(radius=0.03, length=0.1, at=(0.0, -0.03 - 0.5 * THICKNESS, 0.0))
            add_contact(m, "drum", sheet, drum, points=(4, 3), friction=0.3, stiffness=5e6, depth=2e-5)
            for k, share in enumerate((0.25, 0.5, 0.25)):
                pull = PointForce(magnitude=Ramp(height=share * load, duration=0.05), axis=(0.0, -1.0, 0.0))
                m.force(f"load{k}", pull, sheet.node(-1, k))
            m.output("traction", nip.traction())
            found, took = run(m, 0.35, 1e-3, 1e-4)
            felt = float(found["traction"][200:].mean()) / load
            yield ratio(f"{nodes} x 3, {way}", np.exp(-np.sign(speed) * 0.15 * np.pi), felt, "", took)


CASES: dict[str, Callable[[list[int]], Iterator[Row]]] = {
    "hang": hang, "feed": feed, "guide": guide, "friction": friction, "buckle": buckle, "capstan": capstan,
}  # fmt: skip


def main() -> None:
    """Print a table of every case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", choices=CASES, metavar="CASE", help="one of " + ", ".join(CASES))
    parser.add_argument("--nodes", nargs="+", type=int, default=[], metavar="N", help="along the strip, 3 across")
    given = parser.parse_args()
    for name in given.cases or CASES:
        print(
            format_table((name, "reference", "found", "difference", "CPU [s]"), list(CASES[name](given.nodes))),
            flush=True,
        )


if __name__ == "__main__":
    main()
