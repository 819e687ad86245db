"""A strip that a nip feeds onto a guide of 45 degrees: ``python benchmarks/transport.py [NODES ...]``.

Paper of 80 g/m^2, 30 mm wide, fed at 0.1 m/s without friction. What the guide feels is set against the elastica with
weight (a two-point boundary-value problem): 0.10763, 0.09066 and 0.07928 N/m at these lengths. What the roller holds
back with is set against how the energy of that elastica changes with its length. Both are means over a millimeter.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from mbfmu.direct import simulate
from mbfmu.mechanics import Guide, Mechanism, Polynomial, Revolute, Wall, add_nip, add_sheet, add_touch
from mbfmu.table import table

SPEED, START, LENGTH, WIDTH, THICKNESS, RADIUS = 0.1, 0.03, 0.297, 0.03, 1e-4, 0.01
LENGTHS = np.array([0.06015, 0.0801, 0.09606])  # m, of what has been fed
FORCE = np.array([0.10763, 0.09066, 0.07928])  # N/m, on the guide
HELD = np.array([0.0488, 0.0367, 0.0353])  # N/m
UP = np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0)


def strip(nodes: int) -> Mechanism:
    """Nip at x = 0, a channel behind it, a guide that rises from x = 40 mm."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    sheet = add_sheet(
        m, "strip", length=LENGTH, width=WIDTH, thickness=THICKNESS, youngs_modulus=4e9, poisson=0.0, density=800.0,
        grid=(nodes, 3), tree="master", membrane=True, damping=5e-4, at=(START - LENGTH, 0.0, -0.5 * WIDTH),
        rate=(SPEED, 0.0, 0.0, 0.0, 0.0, 0.0),
    )  # fmt: skip
    axle = Revolute(at=(0.0, -RADIUS, 0.0), drive=Polynomial((0.0, -SPEED / RADIUS)))
    roller = m.body("roller", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
    nip = add_nip(
        m, "nip", sheet, roller, radius=RADIUS, at=(0.0, 0.0, 0.0), width=WIDTH, force=2.0, contact=1e-3, stiffness=8e5
    )
    for name, y in (("below", -0.5 * THICKNESS - 1.02e-3), ("above", 0.5 * THICKNESS + 1.3e-3)):
        plate = Guide(start=(-0.5, y, 0.0), end=(-2e-3, y, 0.0), radius=1e-3, width=0.1)
        add_touch(m, name, sheet, plate, points=(6, 3), stiffness=2e6, depth=2e-5)
    wall = Wall(at=np.array([0.04, 0.0, 0.0]) - 0.5 * THICKNESS * UP, normal=UP)
    guide = add_touch(m, "guide", sheet, wall, points=(6, 3), stiffness=2e6, depth=2e-5)
    for axis in "xy":
        m.output(f"guide.{axis}", guide.force(axis))
    m.output("traction", nip.traction())
    m.output("tail", sheet.node(0, 1).position("x"))
    return m


def main() -> None:
    """Print a table of grids."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("nodes", nargs="*", type=int, default=[25], metavar="NODES")
    lines = []
    for nodes in parser.parse_args().nodes:
        model, begin = strip(nodes), time.process_time()
        end = float((LENGTHS[-1] - START) / SPEED) + 1e-3
        found = simulate(model, stop_time=end, interval=2e-4, solver="esdirk", tolerance=1e-5)
        took, fed = time.process_time() - begin, LENGTH + found["tail"]
        near = [abs(fed - length) < 0.5e-3 for length in LENGTHS]
        force = [np.hypot(found["guide.x"], found["guide.y"])[k].mean() / WIDTH for k in near]
        held = [-found["traction"][k].mean() / WIDTH for k in near]
        errors = [f"{100.0 * (f / g - 1.0):+.2f} %" for f, g in zip(force, FORCE, strict=True)]
        lines.append((f"{nodes} x 3", *errors, *(f"{h:.4f}" for h in held), f"{took:.1f}"))
    names = [f"force at {1e3 * length:.1f} mm" for length in LENGTHS]
    held_names = [f"held back, {h:.4f} N/m" for h in HELD]
    print(table(("nodes", *names, *held_names, "CPU [s]"), lines))


if __name__ == "__main__":
    main()
