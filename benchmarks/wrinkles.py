"""Wrinkles of a sheared film: ``python benchmarks/wrinkles.py [THICKNESS mm] [NX NZ]``.

A film between two clamped rails, one of which slides along itself by H / 43: the film of Wong and Pellegrino (Wrinkled
membranes, J. Mech. Mater. Struct. 1, 2006), but thicker, as a wave wants nine cells. Slight forces at random break the
symmetry, damping and air bring it to rest.

The output is the length of a wave along the middle line and its height, and those of tension field theory: along 45
degrees the film is pulled by T = E t gamma / 2 over the length H sqrt(2), so that (Cerda and Mahadevan, Phys. Rev.
Lett. 90, 2003) a wave is 2 sqrt(pi) (B / T)^(1/4) (H sqrt(2))^(1/2) long across, and it is as high as takes up the part
(1 - nu) gamma / 2 by which the film is wider than the field: A = wave sqrt((1 - nu) gamma / 2) / pi.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import mbfmu as mb
from mbfmu.mechanics import Mechanism, PointForce, Step, Translational
from mbfmu.sheets import Support, add_sheet

LENGTH, HEIGHT, SHEAR = 0.38, 0.128, 3e-3  # m
E, NU, DENSITY = 3.5e9, 0.31, 1500.0
SLIGHT = 2e-5  # N


def film(t: float, nx: int, nz: int) -> Mechanism:
    """The film of thickness t (m) on nx x nz nodes, whose middle line is an output."""
    m, chance = Mechanism(), np.random.default_rng(0)
    rail = m.body("rail", m.ground, Translational(axis="x", drive=Step(height=SHEAR, begin=0.05, duration=0.5)))
    sheet = add_sheet(
        m, "film", length=LENGTH, width=HEIGHT, thickness=t, youngs_modulus=E, poisson=NU, density=DENSITY,
        grid=(nx, nz), supports=[Support("z0"), Support("z1", body=rail)], stretch=True, damping=2e-4, drag=50.0,
    )  # fmt: skip
    for i in range(1, nx - 1):
        for k in range(1 + i % 3, nz - 1, 3):
            force = PointForce(magnitude=SLIGHT * float(chance.normal()), axis="y")
            m.force(f"slight.{i}.{k}", force, sheet.node(i, k))
    for i in range(nx):
        m.output(f"y{i}", sheet.node(i, nz // 2).position("y"))
    m.output("force", rail.joint_force("x"), "of the ground on the rail")
    return m


def main() -> None:
    """Shear the film and print length and height of its waves."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("thickness", nargs="?", type=float, default=0.8, help="mm (0.8)")
    parser.add_argument("grid", nargs="*", type=int, default=(39, 14), help="nodes (39 14)")
    options = parser.parse_args()
    t, (nx, nz), gamma = 1e-3 * options.thickness, options.grid, SHEAR / HEIGHT
    begin = time.process_time()
    result = mb.simulate(film(t, nx, nz), 0.8, interval=0.1, solver="esdirk", tolerance=1e-3)
    spent = time.process_time() - begin
    x, y = np.linspace(0.0, LENGTH, nx), np.array([result[f"y{i}"][-1] for i in range(nx)])
    inner = slice(nx // 5, nx - nx // 5)  # away from the free edges
    x, y = x[inner], y[inner]
    turns = np.flatnonzero(y[:-1] * y[1:] < 0.0)
    zeros = x[turns] - y[turns] * (x[turns + 1] - x[turns]) / (y[turns + 1] - y[turns])
    wave = 2.0 * float(np.mean(np.diff(zeros))) / np.sqrt(2.0)
    B, T = E * t**3 / (12.0 * (1.0 - NU**2)), 0.5 * E * t * gamma
    theory = 2.0 * np.sqrt(np.pi) * (B / T) ** 0.25 * np.sqrt(HEIGHT * np.sqrt(2.0))
    wider = np.sqrt(0.5 * (1.0 - NU) * gamma) / np.pi
    print(f"{options.thickness:g} mm, {nx} x {nz} nodes, {spent:.0f} s of CPU time; {result.failure or 'at rest'}")
    print(f"wave across   {1e3 * wave:.1f} mm, theory {1e3 * theory:.1f} mm ({100.0 * (wave / theory - 1.0):+.0f} %)")
    print(f"height        {1e3 * np.abs(y).max():.2f} mm, theory {1e3 * theory * wider:.2f} mm")
    print(f"force         {result['force'][-1]:.0f} N")


if __name__ == "__main__":
    main()
