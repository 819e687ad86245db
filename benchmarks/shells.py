"""Standard problems of thin shells: ``python benchmarks/shells.py [NAME ...]``.

Every problem of ``mbfmu.verification.mechanisms.shells`` and ``plates`` on several meshes: displacements, their
differences from published values, number of factorizations, and the time of the solution.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

from mbfmu.mechanics import Mechanism
from mbfmu.sheets import Support, add_sheet
from mbfmu.steady.equilibrium import build_problem, equilibrium
from mbfmu.util.errors import EquilibriumError
from mbfmu.util.text_table import format_table
from mbfmu.verification.mechanisms import plates, shells
from mbfmu.verification.mechanisms.shells import LoadedShell

Mesh = tuple[int, int]
THICK, THIN = 0.32, 0.0032


def converge(what: str, build: Callable[[Mesh], LoadedShell], meshes: tuple[Mesh, ...]) -> None:
    """Print a table of all meshes."""
    lines = []
    for mesh in meshes:
        problem, name = build(mesh), f"{mesh[0]} x {mesh[1]}"
        try:
            found = build_problem(problem.mechanism).solve()
        except EquilibriumError as error:
            print(f"{what}, {name}: {error}")
            continue
        cells = []
        for output, moved in problem.displacements(found.outputs).items():
            cells += [f"{moved:.5g}", f"{100.0 * (moved / problem.published[output] - 1.0):+.2f} %"]
        lines.append((name, *cells, str(found.iterations), f"{found.solve_time:.2f}"))
    names = [cell for name, value in problem.published.items() for cell in (f"{name}, published {value:.5g}", "off by")]
    print(format_table((what, *names, "factorizations", "time [s]"), lines), "\n", flush=True)


def squares(*sizes: int) -> tuple[Mesh, ...]:
    """Return meshes of n x n cells."""
    return tuple((n, n) for n in sizes)


def cook() -> None:
    """Load in the plane, skewed cells."""
    converge("Cook's membrane", lambda mesh: shells.cook(mesh[0]), squares(2, 4, 8, 16, 32))


def strip() -> None:
    """Large rotations of a strip."""
    meshes = ((8, 1), (16, 1), (32, 2))
    converge("sheared strip", shells.sheared_strip, meshes)
    converge("strip rolled by 270 degrees", lambda mesh: shells.rolled_strip(mesh, 1.5 * np.pi), ((12, 1), *meshes[1:]))


def annulus() -> None:
    """Large rotations, bending and twist."""
    converge("slit annulus", shells.slit_annulus, ((24, 4), (30, 6), (60, 8), (80, 10)))


def twisted() -> None:
    """Warped cells."""
    for thickness in (THICK, THIN):
        for axis in "zy":
            converge(
                f"twisted strip, t = {thickness:g}",
                lambda mesh, axis=axis, t=thickness: shells.twisted_strip(mesh, axis, t),
                ((12, 2), (24, 4), (48, 8)),
            )


def hemisphere() -> None:
    """Double curvature, little strain."""
    for what, load in (("pinched hemisphere, linear", 0.02), ("pinched hemisphere, far", 400.0)):
        converge(what, lambda mesh, load=load: shells.pinched_hemisphere(mesh[0], load), squares(8, 16, 32))


def cylinder() -> None:
    """From bending to stretching."""
    converge("pulled cylinder", shells.pulled_cylinder, ((8, 12), (16, 24), (24, 36)))


def buckling() -> None:
    """Plates under compression, with all roots of the tree of joints."""
    for edges in plates.PLATES:
        exact, lines = plates.ritz_buckling_load(edges), []
        for cells in (8, 16, 32):
            for root in plates.ROOTS:
                load = plates.buckling_load(edges, cells, root)
                lines.append((str(cells), root, f"{load:.4f}", f"{100.0 * (load / exact - 1.0):+.2f} %"))
        print(
            format_table((f"{edges} plate, cells", "tree", f"load, by Ritz {exact:.4f}", "off by"), lines),
            "\n",
            flush=True,
        )


def held_sheet(cells: Mesh) -> Mechanism:
    """Return the sheet of the first paper under its weight, held by the middle third of an edge."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    sheet = add_sheet(
        m,
        "sheet",
        length=0.3,
        width=0.21,
        thickness=0.3e-3,
        youngs_modulus=1e10,
        density=1000.0,
        grid=(cells[0] + 1, cells[1] + 1),
        supports=[Support("x1", span=(0.07, 0.14))],
        stretch=True,
    )
    for name, k in {"corner": 0, "middle": cells[1] // 2, "other": cells[1]}.items():
        m.output(name, sheet.node(0, k).position("y"))
    return m


def held() -> None:
    """A clamp that ends inside an edge."""
    lines = []
    for cells in ((14, 12), (32, 24), (50, 36)):
        found = equilibrium(held_sheet(cells))
        heights = (f"{1e3 * found.outputs[name]:.3f}" for name in ("corner", "middle", "other"))
        lines.append((f"{cells[0] + 1} x {cells[1] + 1}", *heights, str(found.iterations), f"{found.solve_time:.2f}"))
    print(
        format_table(("held third, nodes", "corner [mm]", "middle", "other", "factorizations", "time [s]"), lines), "\n"
    )


CASES = {f.__name__: f for f in (cook, strip, annulus, twisted, hemisphere, cylinder, buckling, held)}


def main() -> None:
    """Print the tables of all cases, or of those named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="NAME", help=", ".join(CASES))
    for name in parser.parse_args().cases or CASES:
        CASES[name]()


if __name__ == "__main__":
    main()
