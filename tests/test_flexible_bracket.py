"""Bodies from meshes, and the page on flexible bodies."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.util.errors import UserError

PAGE = Path(__file__).parents[1] / "docs" / "flexible_bodies.md"
skfem: Any = pytest.importorskip("skfem")
mesh_package: Any = pytest.importorskip("meshio")
mesh_files: Any = pytest.importorskip("skfem.io.meshio")
STEEL = {"density": 7800.0, "young": 2.1e11, "poisson": 0.3}
ENDS = {"left": lambda x: x[:, 0] < 1e-6, "right": lambda x: x[:, 0] > 0.1999}


def bar(kind: str = "MeshTet") -> Any:
    """Bar of 200 x 10 x 20 mm, in mm."""
    grid = getattr(skfem, kind).init_tensor(np.linspace(0, 200, 13), np.linspace(0, 10, 2), np.linspace(0, 20, 2))
    named = grid.with_boundaries({"left": lambda x: x[0] == 0.0, "right": lambda x: x[0] == 200.0})
    return mesh_files.to_meshio(named)


@pytest.mark.parametrize("kind", ["MeshTet", "MeshHex"])
def test_a_bar_has_the_frequencies_of_a_slender_beam(kind: str) -> None:
    """First bending frequencies in both planes of Euler's beam; shear and clamped faces change them by 2 %."""
    body = mb.FlexibleBody.from_mesh(bar(kind), **STEEL, interfaces={"left": ENDS["left"]}, length_unit="mm", modes=3)
    exact = [1.8751**2 * np.sqrt(2.1e11 * h**2 / 12.0 / 7800.0) / 0.2**2 for h in (0.01, 0.02)]
    np.testing.assert_allclose(body.frequencies[:2], exact, rtol=0.02)
    assert body.mass == pytest.approx(7800.0 * 0.2 * 0.01 * 0.02, rel=1e-12)


def test_the_bracket_of_the_page_has_the_frequencies_of_calculix() -> None:
    """C3D20 cells, `benchmarks/calculix_bracket.py`; the cells of the same size with 27 nodes are less stiff."""
    x, y = [0, 6, 20, 34, 48, 62, 76, 90, 104.0], [0, 20, 40, 58, 76, 95, 114, 120.0]
    mesh = skfem.MeshHex.init_tensor(np.array(x), np.array(y), np.linspace(-20.0, 20.0, 5))
    center = mesh.p[:, mesh.t].mean(axis=1)
    mesh = mesh_files.to_meshio(mesh.remove_elements(np.flatnonzero((center[0] > 6.0) & (center[1] < 114.0))))
    wall = {"wall": lambda x: (x[:, 0] < 1e-6) & (x[:, 1] < 0.0401)}
    body = mb.FlexibleBody.from_mesh(
        mesh, density=7850.0, young=2.1e11, poisson=0.3, interfaces=wall, length_unit="mm", modes=8
    )
    exact = np.array([1327.458, 2237.151, 3806.555, 14510.11, 15705.78, 19006.96, 30923.27, 45055.09])  # rad/s
    ratios = body.frequencies / exact
    assert 0.99 < ratios.min() <= ratios.max() < 0.998


def test_sets_of_the_mesh_and_functions_name_the_same_nodes() -> None:
    options: dict[str, Any] = {**STEEL, "length_unit": "mm", "modes": 2}
    one = mb.FlexibleBody.from_mesh(bar(), interfaces=ENDS, **options)
    other = mb.FlexibleBody.from_mesh(bar(), interfaces={"left": "left", "right": "right"}, **options)
    np.testing.assert_allclose(other.frequencies, one.frequencies, rtol=1e-9)
    mesh = bar()
    mesh.point_sets = {"fixed": np.flatnonzero(mesh.points[:, 0] == 0.0)}
    single = mb.FlexibleBody.from_mesh(mesh, interfaces={"left": "fixed"}, **options)
    alone = mb.FlexibleBody.from_mesh(bar(), interfaces={"left": ENDS["left"]}, **options)
    np.testing.assert_allclose(single.frequencies, alone.frequencies, rtol=1e-9)
    with pytest.raises(UserError, match=r"set of interface 'left' is 'top', .* allowed: 'left', 'right'"):
        mb.FlexibleBody.from_mesh(bar(), interfaces={"left": "top"}, **options)


def test_a_mesh_stiffens_in_rotation() -> None:
    """Squared frequency across the plane of rotation: more by 1.19 times the squared speed (Southwell)."""
    body = mb.FlexibleBody.from_mesh(
        bar(), **STEEL, interfaces={"left": ENDS["left"]}, length_unit="mm", modes=4, stiffening=True
    )
    squares = []
    for speed in (0.0, 300.0):
        m = mb.Mechanism()
        m.flexible_body("bar", m.ground, mb.Revolute(axis="z", drive=mb.Polynomial((0.0, speed))), body)
        squares.append(sorted(mode.frequency**2 for mode in mb.equilibrium(m).modes)[:2])
    in_plane, across = (np.array(squares[1]) - squares[0]) / 300.0**2
    assert across == pytest.approx(1.193, rel=0.02)
    assert in_plane == pytest.approx(0.193, abs=0.02)


def test_meshes_that_are_no_solids_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot be read"):
        mb.FlexibleBody.from_mesh(tmp_path / "none.msh", **STEEL, interfaces=ENDS)
    flat = mesh_files.to_meshio(skfem.MeshTri.init_tensor(np.arange(3.0), np.arange(3.0)))
    with pytest.raises(UserError, match="mesh has the cells: 8 triangle; allowed: solid cells of one kind"):
        mb.FlexibleBody.from_mesh(flat, **STEEL, interfaces=ENDS)
    for wrong, message in (({"poisson": 0.5}, "poisson is 0.5"), ({"length_unit": "ft"}, "length_unit is 'ft'")):
        with pytest.raises(UserError, match=message):
            mb.FlexibleBody.from_mesh(bar(), **(STEEL | {"interfaces": ENDS} | wrong))


def changed_bar(change: str) -> Any:
    """The bar of hexahedra with an error, or with a node that belongs to no cell."""
    mesh = bar("MeshHex")
    points, cells = mesh.points.copy(), mesh.cells_dict["hexahedron"].copy()
    if change == "mixed":
        more = mesh_files.to_meshio(skfem.MeshTet()).cells_dict["tetra"]
        return mesh_package.Mesh(points, [("hexahedron", cells), ("tetra", more)])
    if change == "twisted":
        cells[0, :2] = cells[0, 1::-1]
    elif change == "flat":
        points[:, 2] = 0.0
    elif change == "twice":
        cells = np.vstack([cells, cells[:3]])
    else:
        points, cells = np.vstack([[0.0, 0.0, 900.0], points]), cells + 1
    return mesh_package.Mesh(points, [("hexahedron", cells)], point_sets={"first": np.arange(len(points))})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("mixed", r"mesh has the cells: 12 hexahedron, \d+ tetra; allowed: solid cells of one kind"),
        ("twisted", "cell 0 of the mesh, .* nodes are in a wrong order"),
        ("flat", "of the mesh, .* is flat"),
        ("twice", "mesh has 3 of its 15 hexahedron cells twice"),
    ],
)
def test_damaged_meshes_are_refused(change: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        mb.FlexibleBody.from_mesh(changed_bar(change), **STEEL, interfaces=ENDS, length_unit="mm", modes=1)


def test_nodes_without_cells_are_left_out() -> None:
    """As the centers of arcs that mesh generators write."""
    options: dict[str, Any] = {**STEEL, "interfaces": ENDS, "length_unit": "mm", "modes": 2}
    found, exact = (mb.FlexibleBody.from_mesh(mesh, **options) for mesh in (changed_bar("node"), bar("MeshHex")))
    np.testing.assert_allclose(found.frequencies, exact.frequencies, rtol=1e-9)
    np.testing.assert_allclose(found.com, exact.com, atol=1e-12)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cut.vtk"
    path.write_text("# vtk DataFile Version 3.0\nbar\nASCII\n")
    with pytest.raises(UserError, match=r"cut.vtk' cannot be read \(KeyError"):
        mb.FlexibleBody.from_mesh(path, **STEEL, interfaces=ENDS)


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    text = PAGE.read_text()
    for name, block in re.findall(r"```python file=(\S+)\n(.*?)```", text, flags=re.DOTALL):
        (tmp_path / name).write_text(block)
    exec(compile((tmp_path / "make_mesh.py").read_text(), "make_mesh.py", "exec"), {})
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        exec(compile(block, str(PAGE), "exec"), names)
    (printed,) = re.findall(r"```text\n(.*?)```", text, flags=re.DOTALL)
    assert capsys.readouterr().out == printed
    beam = names["beam"]
    exact = np.array([1.8751, 1.8751, 4.6941, 4.6941]) ** 2 * np.sqrt(50.0 / 0.5)
    np.testing.assert_allclose(beam.frequencies[:4], exact, rtol=3e-3)
