"""Surfaces that sheets touch and rollers of nips, in pictures, pages and files."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from scripts import NODE, evaluated
from test_gltf import File
from test_page import browser, opened

from mbfmu.mechanics import Box, Floating, Mechanism, Panel, Revolute, Sphere
from mbfmu.mechanics.kind import record_of
from mbfmu.sheets import Drum, Guide, Surface, Trough, Wall, add_contact, add_nip, add_sheet
from mbfmu.sheets.contact.scratch import CONTACT_SCRATCH
from mbfmu.sheets.contact.surfaces.guide import gap as guide_gap
from mbfmu.sheets.contact.surfaces.trough import gap as trough_gap
from mbfmu.util.errors import UserError
from mbfmu.viewer import Motion, html, images
from mbfmu.viewer.drawing import draw
from mbfmu.viewer.gltf import glb
from mbfmu.viewer.picture import Part
from solvers.compiled.kernel import kernel, records

NONE = np.zeros((1, 3))
GUIDE = Guide(start=(0.1, 0.0, 0.0), end=(0.1, 0.3, 0.4), radius=0.02, width=0.2, across="x")
TROUGH = Trough(radius=0.3, length=0.2, angle=2.0, towards=(0.0, 1.0, 1.0), at=(0.1, 0.2, 0.3), axis="x")


@kernel
def distance(gap: Any, surface: Any, state: Any) -> float:
    return gap(surface, state)


def corners(shape: Any) -> Any:
    """Of a panel, (4, 3)."""
    signs = np.array([(-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0)])
    return signs @ shape.axes().T + shape.at


@pytest.mark.parametrize(
    ("surface", "gap", "area"),
    [
        (GUIDE, guide_gap, 2.0 * (0.5 + np.pi * 0.02) * 0.2),
        (TROUGH, trough_gap, 2.0 * 0.3 * 0.2),
    ],
    ids=["guide", "trough"],
)
def test_what_is_drawn_of_a_surface_is_where_it_is_felt(surface: Surface, gap: Any, area: float) -> None:
    record, contact = records(1, record_of(surface)), records(1, CONTACT_SCRATCH)
    surface.fill(record[0], SimpleNamespace())  # type: ignore[arg-type]
    panels = surface.shapes(NONE)
    for panel in panels:
        assert panel.opacity < 1.0
        for corner in corners(panel):
            contact["p"][0] = corner
            contact["part"][0] = 1.0
            assert abs(distance(gap, record[0], contact[0])) < 1e-12
            assert contact["part"][0] > 0.249  # of one: half is left at an end, a quarter where two meet
    sizes = [np.linalg.norm(np.cross(c[1] - c[0], c[3] - c[0])) for c in map(corners, panels)]
    assert sum(sizes) == pytest.approx(area, rel=2e-3)


def test_a_wall_is_drawn_where_a_sheet_comes_near() -> None:
    wall = Wall(at=(0.0, 0.1, 0.0), normal=(0.0, 1.0, 0.0))
    near = np.array([(0.2, 0.1, 0.3), (0.3, 0.11, 0.4), (-5.0, 3.0, 0.0)])
    (panel,) = wall.shapes(near)
    span = corners(panel)
    assert span[:, 1] == pytest.approx(0.1)
    low, high = span.min(axis=0), span.max(axis=0)
    reach = 0.1 * float(np.linalg.norm(np.ptp(near, axis=0)))
    assert low[[0, 2]] == pytest.approx(np.array((0.2, 0.3)) - reach)
    assert high[[0, 2]] == pytest.approx(np.array((0.3, 0.4)) + reach)
    assert wall.shapes(NONE) == ()


def test_a_wall_on_a_turned_body_is_below_the_sheet() -> None:
    """The body is turned by a right angle about z and off by 0.7 m: its wall of normal x lies across y."""
    mechanism = feeder(Wall(at=(0.1, 0.0, 0.0), normal=(1.0, 0.0, 0.0)))
    arm, nodes = mechanism.bodies[-1], [node.index for row in mechanism.meshes[0].nodes for node in row]
    count = len(mechanism.bodies)
    r, A = np.zeros((3, count, 3), np.float32), np.tile(np.eye(3, dtype=np.float32), (3, count, 1, 1))
    A[:, arm.index] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    r[:, arm.index] = (0.0, 0.7, 0.0)
    places = np.random.default_rng(3).uniform((-0.2, 0.8, -0.1), (0.3, 0.81, 0.2), (2, len(nodes), 3))
    r[:2, nodes] = places
    r[2, nodes] = np.nan  # a run that has failed
    (panel,) = [p for p in draw(mechanism, 0.3, (r, A)).parts if p.body == arm.index and p.opacity < 1.0]
    x, y, _ = np.reshape(panel.axes, (3, 3)) * 0.5
    own = np.array(panel.at) + np.array([x + y, x - y, -x + y, -x - y])
    seen = own @ A[0, arm.index].T + r[0, arm.index]
    assert seen[:, 1] == pytest.approx(0.8)
    reach = 0.1 * float(np.linalg.norm(np.ptp(places.reshape(-1, 3), axis=0)))
    for k in (0, 2):
        span = places[..., k].min() - reach, places[..., k].max() + reach
        assert (seen[:, k].min(), seen[:, k].max()) == pytest.approx(span, abs=1e-6)


class Knob(Wall):
    """A user's own."""

    def shapes(self, near: Any) -> tuple[Any, ...]:
        return (Sphere(radius=0.01, at=(0.0, -0.01, 0.0), color="#102030"),)


def feeder(surface: Surface, *, shaped: bool = False, turned: float = 0.0) -> Mechanism:
    """A sheet, a nip next to the middle of its roller, and a surface on a body and on the ground."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    sheet = add_sheet(
        m, "paper", length=0.3, width=0.2, thickness=1e-3, youngs_modulus=4e7, density=800.0, grid=(4, 3),
        tree="master", membrane=True, at=(-0.1, 0.0, -0.1),
    )  # fmt: skip
    about = [[np.cos(turned), -np.sin(turned), 0.0], [np.sin(turned), np.cos(turned), 0.0], [0.0, 0.0, 1.0]]
    axle = Revolute(at=(0.02, -0.05, 0.0), rotation=about)
    roller = m.body("roller", m.ground, axle, mass=0.1, inertia=(1e-4, 1e-4, 1e-4))
    add_nip(m, "nip", sheet, roller, radius=0.05, at=(0.02, 0.0, 0.03), width=0.06, force=3.0)
    arm = m.body("arm", m.ground, Floating(), mass=0.1, inertia=(1e-4, 1e-4, 1e-4))
    add_contact(m, "one", sheet, surface, body=arm)
    add_contact(m, "other", sheet, surface)
    if shaped:
        m.shape(roller, Box(size=(0.1, 0.1, 0.1)))
        m.shape(arm, Box(size=(0.1, 0.1, 0.1)))
    return m


def test_every_surface_is_drawn_once_on_its_body() -> None:
    drum = Drum(radius=0.2, length=0.3, at=(0.0, -0.2, 0.0))
    parts = draw(feeder(drum), 0.3).parts
    glass = [part for part in parts if part.opacity < 1.0]
    assert sorted(part.body for part in glass) == [0, feeder(drum).bodies[-1].index]
    for part in glass:
        assert (part.solid, part.at) == ("cylinder", (0.0, -0.2, 0.0))
        assert abs(np.linalg.det(np.reshape(part.axes, (3, 3)))) == pytest.approx(0.2 * 0.2 * 0.3)


def test_a_user_defined_surface_is_drawn_by_its_lines() -> None:
    knobs = [part for part in draw(feeder(Knob()), 0.3).parts if part.color == "#102030"]
    assert [part.solid for part in knobs] == ["sphere", "sphere"]
    plain = draw(feeder(type("Plain", (Wall,), {"shapes": Surface.shapes})()), 0.3).parts
    assert all(part.opacity == 1.0 for part in plain)


def test_bodies_with_shapes_are_drawn_with_them() -> None:
    mechanism = feeder(Drum(radius=0.2, length=0.3), shaped=True)
    roller, arm = (mechanism.bodies[k].index for k in (-2, -1))
    own = [part.solid for part in draw(mechanism, 0.3).parts if part.body == arm]
    assert own == ["box"]
    assert [p.solid for p in draw(mechanism, 0.3).parts if p.body == roller and p.solid == "box"] == ["box"]
    assert sum(part.opacity < 1.0 for part in draw(mechanism, 0.3).parts) == 1  # that on the ground


@pytest.mark.parametrize("turned", [0.0, 0.7])
def test_a_nip_has_its_roller_with_marks_and_an_idler(turned: float) -> None:
    mechanism = feeder(Knob(), turned=turned)
    roller = mechanism.bodies[-2]
    drum, *marks = (part for part in draw(mechanism, 0.3).parts if part.body == roller.index)
    assert drum.at == pytest.approx((0.0, 0.0, 0.03))  # next to the middle of its body
    x, y, z = np.reshape(drum.axes, (3, 3))
    assert (np.linalg.norm(x), np.linalg.norm(y)) == pytest.approx((0.05, 0.05))
    assert np.abs(z) == pytest.approx((0.0, 0.0, 0.06))
    assert marks
    for mark in marks:  # off the axis: they go round with the body
        assert 0.8 * 0.05 < np.hypot(*mark.at[:2]) < 0.05
        assert mark.color != drum.color
    (idler,) = [part for part in draw(mechanism, 0.3).parts if part.body == 0 and part.solid == "cylinder"]
    radius = float(np.linalg.norm(idler.axes[:3]))
    assert radius < 0.05
    assert idler.at == pytest.approx((0.02, radius, 0.03))  # it touches the plane of the nip from above


def test_translucency_is_a_part_of_one() -> None:
    for opacity in (-0.1, 1.5, float("nan")):
        with pytest.raises(UserError, match="opacity of a shape"):
            Panel(size=(1.0, 1.0), opacity=opacity)
    with pytest.raises(UserError, match="size of a panel"):
        Panel(size=(1.0, 0.0)).axes()


def windowed(*shapes: Any) -> Motion:
    """A body at rest with these shapes."""
    m = Mechanism()
    body = m.body("body", m.ground, Floating(), mass=1.0)
    m.shape(body, *shapes)
    r, e = np.zeros((2, 2, 3), np.float32), np.zeros((2, 2, 4), np.float32)
    e[..., 0] = 1.0
    return Motion(
        title="", times=np.array([0.0, 1.0]), names=("ground", "body"), parents=(0, 0), joints=("", "floating"),
        outputs=(), values=np.zeros((2, 0)), arrows=(), forces=np.zeros((2, 0, 3), np.float32), r=r, e=e,
        p=np.zeros((2, 0), np.float32), picture=draw(m, 1.0),
    )  # fmt: skip


BALL = Sphere(radius=0.3, at=(0.0, 0.0, -1.0), color="#ff0000")


def window(opacity: float) -> Panel:
    """It stands before the ball."""
    return Panel(size=(2.0, 2.0), color="#0000ff", opacity=opacity)


def test_picture_shows_what_is_behind_glass(tmp_path: Path) -> None:
    def shot(*shapes: Any) -> Any:
        images.write_png(windowed(*shapes), tmp_path / "m.png", 0.0, images.Shot(300, 300, 0.0, 0.0))
        return imread(tmp_path / "m.png")[..., :3].astype(float)

    glass = shot(window(0.25), BALL)
    assert glass[150, 150, 0] > 2.0 * glass[150, 150, 2]  # the ball
    full = shot(window(1.0), BALL)
    assert full[150, 150, 2] > 2.0 * full[150, 150, 0]  # nothing but the panel
    empty = shot(Sphere(radius=1e-3), window(0.0), BALL)
    here = (100, 60)  # on the panel, next to the ball
    assert glass[here] == pytest.approx(0.25 * full[here] + 0.75 * empty[here], abs=0.02)


def test_gltf_blends_glass() -> None:
    file = File(glb(windowed(window(0.25), BALL))[0])
    materials = {tuple(m["pbrMetallicRoughness"]["baseColorFactor"]): m for m in file.told["materials"]}
    clear, red = materials[0.0, 0.0, 1.0, 0.25], materials[1.0, 0.0, 0.0, 1.0]
    assert (clear["alphaMode"], clear["doubleSided"]) == ("BLEND", True)
    assert ("alphaMode" in red, red["doubleSided"]) == (False, False)
    (panel,) = [mesh for mesh in file.told["meshes"] if file.told["materials"].index(clear) == material(mesh)]
    points = file.array(panel["primitives"][0]["attributes"]["POSITION"])
    assert np.ptp(points, axis=0) == pytest.approx((1.0, 1.0, 0.0))


def material(mesh: dict[str, Any]) -> int:
    (primitive,) = mesh["primitives"]
    return int(primitive["material"])


def test_pose_file_keeps_glass_and_reads_files_from_before_it(tmp_path: Path) -> None:
    motion = windowed(window(0.25), BALL)
    motion.save(tmp_path / "m.npz")
    assert Motion.load(tmp_path / "m.npz").picture == motion.picture
    old = {"solid": "box", "body": 0, "at": (0.0,) * 3, "axes": (0.0,) * 9, "color": "#000000"}
    assert Part(**old).opacity == 1.0  # type: ignore[arg-type]


@pytest.mark.skipif(NODE is None, reason="no node here, which the page's program is tested with")
def test_page_draws_glass_last_and_picks_through_it() -> None:
    found = evaluated(
        """
        const scene = JSON.parse(block("scene")), drawn = [];
        const renderer = {
          solids: (mesh, count) => ({ data: new Float32Array(INSTANCE * count), count }),
          update() {},
          drawSolids: (item) => drawn.push(["solid", item.count]),
          glass: (item, opacity) => drawn.push(["glass", item.count, opacity]),
        };
        const figure = new Figure(renderer, scene, new Motion(scene, await recorded()), 1, scene.stops);
        figure.place(0);
        figure.draw(false);
        figure.drawGlass();
        const panel = Array.from(figure.glasses[0].item.data.slice(0, 12));
        const inside = distanceTo("panel", figure.glasses[0].item.data, 0, [0.9, 0.9, 5], [0, 0, -1]);
        return [drawn, panel, picked(figure, [0, 0, 5], [0, 0, -1]), picked(figure, [0.8, 0.8, 5], [0, 0, -1]), inside];
        """,
        html.page(windowed(window(0.25), window(0.25), BALL))[0],
    )
    drawn, panel, through, beside, inside = found
    assert drawn == [["solid", 1], ["glass", 2, 0.25]]
    assert panel[:6] == pytest.approx([2.0, 0.0, 0.0, 0.0, 2.0, 0.0])
    assert (through, beside) == (1, None)
    assert inside == pytest.approx(5.0, abs=2e-3)


@pytest.mark.skipif(browser() is None, reason="no Chromium here; MBFMU_BROWSER may name one")
def test_a_browser_shows_the_ball_through_glass(tmp_path: Path) -> None:
    page, picture = tmp_path / "page.html", tmp_path / "page.png"
    found = {}
    for opacity in (0.25, 1.0):
        html.write_html(windowed(window(opacity), BALL), page)
        assert 'data-state="ready"' in opened(page, "--dump-dom")
        opened(page, f"--screenshot={picture}")
        seen = imread(picture)[..., :3]
        found[opacity] = int(((seen[..., 0] > 0.5) & (seen[..., 0] > 2.0 * seen[..., 1])).sum())
    assert found[0.25] > 300
    assert found[1.0] < found[0.25]
