"""Bracket of ``docs/flexible_bodies.md`` against CalculiX: frequencies, a static displacement, number of modes.

``python benchmarks/calculix_bracket.py`` requires the program ``ccx`` (Debian: ``apt-get install calculix-ccx``) and
the extra ``fe``. CalculiX computes the clamped bracket with quadratic hexahedra of 20 nodes (C3D20), and writes the
matrices of the free one. The matrices are read by ``FlexibleBody.from_files``; ``from_mesh`` takes the same cells, with
27 nodes.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

import mbfmu as mb

YOUNG, POISSON, DENSITY = 210000.0, 0.3, 7.85e-9  # MPa, 1, t/mm^3
FORCE = 10.0  # N on the pad, down
COUNT = 8  # frequencies
CORNERS = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))  # of C3D20
INTERFACES = {
    "wall": lambda x: (x[:, 0] < 1e-6) & (x[:, 1] < 0.0401),
    "pad": mb.Interface(nodes=lambda x: (x[:, 0] > 0.047) & (x[:, 1] > 0.1199), tie="average"),
}


class Deck:
    """Input decks of the bracket.

    Attributes
    ----------
    positions
        Positions (n, 3) of the nodes, mm.
    """

    def __init__(self) -> None:
        x, y = np.array([0, 6, 20, 34, 48, 62, 76, 90, 104.0]), np.array([0, 20, 40, 58, 76, 95, 114, 120.0])
        z, numbers = np.linspace(-20.0, 20.0, 5), dict[tuple[float, ...], int]()
        self.elements = []
        for i, j, k in np.ndindex(len(x) - 1, len(y) - 1, len(z) - 1):
            low, high = np.array([x[i], y[j], z[k]]), np.array([x[i + 1], y[j + 1], z[k + 1]])
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            if middle[0] > 6.0 and middle[1] < 114.0:
                continue
            corners = middle + CORNERS * half
            places = [*corners, *(0.5 * (corners[a] + corners[b]) for a, b in EDGES)]
            keys = [tuple(float(value) for value in np.round(place, 9)) for place in places]
            self.elements.append([numbers.setdefault(key, len(numbers) + 1) for key in keys])
        self.positions = np.array(list(numbers))

    def nodes(self, name: str) -> NDArray[np.int64]:
        """Return the numbers of the nodes of an interface."""
        given = INTERFACES[name]
        chosen = given.nodes if isinstance(given, mb.Interface) else given
        return 1 + np.flatnonzero(chosen(1e-3 * self.positions))  # type: ignore[operator]

    def text(self, step: str, *, is_clamped: bool) -> str:
        """Return a deck with one step."""
        lines = ["*HEADING", "bracket of steel; t, mm, N", "*NODE"]
        lines += [f"{k}, {', '.join(f'{value:.9g}' for value in p)}" for k, p in enumerate(self.positions, 1)]
        lines.append("*ELEMENT, TYPE=C3D20, ELSET=ALL")
        for number, own in enumerate(self.elements, 1):
            lines += [f"{number}, {', '.join(map(str, own[:10]))},", ", ".join(map(str, own[10:]))]
        lines += [f"*MATERIAL, NAME=STEEL\n*ELASTIC\n{YOUNG}, {POISSON}\n*DENSITY\n{DENSITY}"]
        lines += ["*SOLID SECTION, ELSET=ALL, MATERIAL=STEEL"]
        lines += ["*BOUNDARY", *(f"{node}, 1, 3" for node in self.nodes("wall"))] if is_clamped else []
        return "\n".join([*lines, "*STEP", step, "*END STEP", ""])


def run(folder: Path, name: str, deck: str) -> str:
    """Return what CalculiX writes to the file ``.dat``."""
    (folder / f"{name}.inp").write_text(deck)
    subprocess.run(["ccx", name], cwd=folder, check=True, capture_output=True)
    return (folder / f"{name}.dat").read_text()


def frequencies(text: str, first: int = 0) -> NDArray[np.float64]:
    """Return the frequencies in a file ``.dat``, rad/s, without the first ones."""
    table = text.split("P A R T I C I P A T I O N", maxsplit=1)[0]
    found = re.findall(r"^ +\d+ +\S+E\S+ +(\S+) +\S+ +\S+$", table, re.MULTILINE)
    return np.array(found[first : first + COUNT], float)


def deflection(body: mb.FlexibleBody) -> float:
    """Return the displacement of the pad by the force, m."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    arm = m.flexible_body("bracket", m.ground, mb.Weld(), body)
    m.force("load", mb.PointForce(magnitude=-FORCE, axis="y"), arm.section("pad"))
    m.output("y", arm.section("pad").position("y"))
    start = mb.simulate(m, 1e-6, interval=1e-6)["y"][0]
    return float(mb.equilibrium(m).outputs["y"] - start)


def print_errors_of_modes(
    files: list[Path], rows: Path, clamped: NDArray[np.float64], free: NDArray[np.float64]
) -> None:
    """Print errors of four frequencies over the number of modes with fixed interfaces, clamped and free."""
    rest = {"rows": rows, "length_unit": "mm"}
    loose = {"wall": mb.Interface(nodes=INTERFACES["wall"], tie="average")}
    for modes in (0, 2, 4, 8, 16):
        held = mb.FlexibleBody.from_files(*files, INTERFACES, modes=modes, **rest)
        flying = mb.FlexibleBody.from_files(*files, INTERFACES | loose, modes=modes, frame="center", **rest)
        errors = [*(held.frequencies[:4] / clamped[:4] - 1.0), *(flying.frequencies[:4] / free[:4] - 1.0)]
        print(f"| {modes} | " + " | ".join(f"{error:.1e}" for error in errors) + " |")


def main() -> None:
    """Print the comparisons."""
    import skfem
    from skfem.io.meshio import to_meshio

    deck = Deck()
    with TemporaryDirectory() as name:
        folder = Path(name)
        exact = frequencies(run(folder, "clamped", deck.text("*FREQUENCY\n10", is_clamped=True)))
        pad = deck.nodes("pad")
        loads = "\n".join(f"{node}, 2, {-FORCE / len(pad):.12g}" for node in pad)
        step = f"*STATIC\n*CLOAD\n{loads}\n*NODE PRINT, NSET=PAD\nU"
        static = deck.text(step, is_clamped=True).replace(
            "*STEP", "*NSET, NSET=PAD\n" + ",\n".join(map(str, pad)) + "\n*STEP", 1
        )
        rows = re.findall(r"^ +\d+ +(\S+) +(\S+) +(\S+)$", run(folder, "static", static), re.MULTILINE)
        loaded = 1e-3 * float(np.mean([float(row[1]) for row in rows]))
        free = frequencies(run(folder, "flying", deck.text("*FREQUENCY\n14", is_clamped=False)), first=6)
        run(folder, "free", deck.text("*FREQUENCY, SOLVER=MATRIXSTORAGE\n10", is_clamped=False))
        files = [folder / f"free.{ending}" for ending in ("mas", "sti", "inp")]
        rest = {"rows": folder / "free.dof", "length_unit": "mm", "modes": COUNT}
        wall = {"wall": INTERFACES["wall"]}
        read = mb.FlexibleBody.from_files(*files, wall, **rest)
        print_errors_of_modes(files, folder / "free.dof", exact, free)
        moved = deflection(mb.FlexibleBody.from_files(*files, INTERFACES, **rest))
    x, y = np.unique(deck.positions[:, 0])[::2], np.unique(deck.positions[:, 1])[::2]
    mesh = skfem.MeshHex.init_tensor(x, y, np.linspace(-20.0, 20.0, 5))
    center = mesh.p[:, mesh.t].mean(axis=1)
    mesh = to_meshio(mesh.remove_elements(np.flatnonzero((center[0] > 6.0) & (center[1] < 114.0))))
    steel = {"density": 7850.0, "young": 2.1e11, "poisson": POISSON, "length_unit": "mm", "modes": COUNT}
    meshed = mb.FlexibleBody.from_mesh(mesh, interfaces=wall, **steel)
    print("| CalculiX, Hz | from_files | from_mesh |\n|---|---|---|")
    for k in range(COUNT):
        own, other = (body.frequencies[k] / exact[k] - 1.0 for body in (read, meshed))
        print(f"| {exact[k] / (2.0 * np.pi):.2f} | {own:+.1e} | {100.0 * other:+.2f} % |")
    print(f"displacement of the pad: CalculiX {1e6 * loaded:.4f} um, from_files {moved / loaded - 1.0:+.1e}")
    of_mesh = deflection(mb.FlexibleBody.from_mesh(mesh, interfaces=INTERFACES, **steel))
    print(f"from_mesh {100.0 * (of_mesh / loaded - 1.0):+.2f} %")


if __name__ == "__main__":
    main()
